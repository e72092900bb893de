"""What a program reads of a session has a type: a checker finds mistakes in it before it runs."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PROGRAM = """
import telenano

soft = telenano.simulate("fig12", law="wave", round_trip_ms=40.0, operator={"kind": "force_profile"}, settings={"a": 1})
recorded = telenano.open("out/session.mcap")
made = telenano.simulate("fig12", recording="out/new", seed=1)


def read(session: telenano.Session) -> int:
    print(session.verdict, session.reason, session.measured_round_trip_ms, session.units, session.descriptions)
    for hold in session.holds:
        print(hold.start_s, hold.hold_ratio, hold.verdict, hold.has("struck"), [fact.text for fact in hold.facts])
    stated = session.conditions
    print(stated.scenario, stated.law, stated.round_trip_ms, stated.link_profile, stated.link_seed, stated.environment)
    print(stated.sample, stated.hand, stated.instrument, stated.changed, stated.title())
    print(session.channels["afm/state"], session.table("afm/state").units["tip_force_n.2"])
    session.plot().savefig("fig12.png")
    pressed = session["tip_force_n"][session["in_contact"]]
    return pressed.size


print(recorded.start_ns, recorded.is_judged, telenano.check_law("wave"), telenano.__version__)
print([read(session) for session in (soft, recorded, made)])
with telenano.live() as rig:
    for channel, message in rig.messages(duration_s=1.0):
        print(channel, message.t_ns)
"""
MISTAKES = {
    "telenano.opne('a')": "opne",
    "telenano.open('a').verdikt": "verdikt",
    "telenano.simulate(delay=1.0)": "delay",
    "telenano.simulate().conditions.delay": "delay",
    "telenano.simulate().verdict == 'unstable'": "Non-overlapping",
}


def checked(path: Path, text: str, *options: str) -> list[str]:
    path.write_text(text)
    command = [sys.executable, "-m", "mypy", "--strict", *options, str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return [line for line in done.stdout.splitlines() if ": error:" in line]


@pytest.mark.check("takes 20 s")
@pytest.mark.drawn(0.0, "telenano/api/", "telenano/analysis/")
def test_nothing_that_a_session_gives_is_any(tmp_path: Path) -> None:
    assert checked(tmp_path / "program.py", PROGRAM, "--disallow-any-expr") == []


@pytest.mark.check("takes 10 s")
@pytest.mark.drawn(0.0, "telenano/api/")
def test_a_checker_finds_each_mistake(tmp_path: Path) -> None:
    text = "import telenano\n\n" + "\n".join(f"print({line})" for line in MISTAKES)
    found = checked(tmp_path / "program.py", text)
    assert len(found) == len(MISTAKES)
    for line, word in zip(found, MISTAKES.values(), strict=True):
        assert word in line

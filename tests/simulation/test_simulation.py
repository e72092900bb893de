"""Sessions with faults: a seed reproduces them, an outside judge checks them, and every planted fault is found."""

import datetime
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import campaign
import faulty_rig
import msgpack
import outside_judge
import pytest
from campaign import INVARIANTS, Tried, tried
from fault_schedule import HAND, KINDS, LINK, OPERATORS, PROCESSES, RATES_HZ, SESSION_S, TIP, Event, Schedule
from planted import PLANTED
from reached import SITUATIONS
from shrunk import MOST_EVENTS, shrunk

from telenano.signals import children

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
HOURS = float(os.environ.get("SIMULATED_HOURS", "1.0"))
SEED_OF_THE_DAY = datetime.datetime.now(datetime.UTC).date().toordinal() * 1000

_STOP: Event = {"at_s": 1.68, "kind": "press", "site": "master", "target": "*"}
# Situations that are told by more than an event of a recording, with a short schedule that makes each.
MADE: dict[str, tuple[Event, ...]] = {
    "a stop while a device was being started again": (
        {"at_s": 1.6, "kind": "kill", "node": TIP, "after": 0, "torn": 0.0},
        {**_STOP, "site": "slave", "target": "afm_node"},
    ),
    "a stop while the link was away": ({"at_s": 1.6, "kind": "kill", "node": LINK, "after": 0, "torn": 0.0}, _STOP),
    "a link that ended between a stop and its answer": (
        _STOP,
        {"at_s": 1.69, "kind": "kill", "node": LINK, "after": 0, "torn": 0.0},
    ),
    "a stop while the instrument stood still": ({"at_s": 1.6, "kind": "stall", "node": TIP, "for_s": 0.3}, _STOP),
    "a stop in a partition": ({"at_s": 1.6, "kind": "partition", "direction": "forward", "for_s": 0.3}, _STOP),
    "a partition in a hold": ({"at_s": 1.9, "kind": "partition", "direction": "backward", "for_s": 0.3},),
    "a step of the delay in a hold": ({"at_s": 1.7, "kind": "delay", "forward_s": 0.03, "backward_s": 0.03},),
    "a half that ended after a change of the law": (
        {"at_s": 1.3, "kind": "law", "law": "virtual_impedance"},
        {"at_s": 1.9, "kind": "kill", "node": "controller@slave", "after": 0, "torn": 0.0},
    ),
    "a partition while a law changed": (
        {"at_s": 1.6, "kind": "partition", "direction": "both", "for_s": 0.8},
        {"at_s": 1.6, "kind": "law", "law": "virtual_impedance"},
    ),
}


def unexpected(one: Tried) -> list[str]:
    """Return a line for each broken invariant, with the command that repeats it."""
    command = f"python -m tests.simulation --seed {one.schedule.seed} --hours 0.001"
    return [f"{found.invariant}: {found.text}; {command}" for found in one.breaks]


def test_a_schedule_is_data_that_comes_from_its_seed() -> None:
    drawn = [Schedule.drawn(seed) for seed in range(300)]
    assert [Schedule.of(json.loads(one.text())) for one in drawn] == drawn
    assert [Schedule.drawn(seed) for seed in range(300)] == drawn
    assert {event["kind"] for one in drawn for event in one.events} == KINDS
    assert {one.rate_hz for one in drawn} == set(RATES_HZ)
    assert {one.processes for one in drawn} == set(PROCESSES)
    assert {one.operator for one in drawn} == set(OPERATORS)
    assert min(one.session_s for one in drawn) < 2.0
    assert max(one.session_s for one in drawn) == SESSION_S
    ends = {(one["how"]) for each in drawn for one in each.events if one["kind"] == "kill" and "how" in one}
    assert ends == {"killed", "ended", "failed", "replaced"}


@pytest.mark.parametrize("document", [{}, {"seed": 1, "law": "wave", "delay_s": 0.0, "link_s": 0.0, "events": [{}]}])
def test_what_is_no_schedule_is_refused(document: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"schedule|event"):
        Schedule.of(document)


def test_a_failure_is_made_as_small_as_what_it_needs() -> None:
    events: Sequence[Event] = [{"at_s": 0.1 * n, "kind": "stall", "number": n} for n in range(17)]
    schedule = Schedule(1, "wave", 0.0, 0.0, tuple(events))
    for needed in ({3}, {0, 16}, {2, 7, 8}, {1, 4, 9, 12, 15}):

        def breaks(one: Schedule, needed: set[int] = needed) -> bool:
            return needed <= {event["number"] for event in one.events}

        small = shrunk(schedule, breaks, most_tries=500)
        assert {event["number"] for event in small.events} == needed
        assert len(small.events) <= MOST_EVENTS


def test_the_judge_imports_nothing_of_the_project() -> None:
    code = (
        "import outside_judge, sys; print([m for m in sys.modules if m.partition('.')[0] in ('telenano', 'services')])"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=HERE, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


@pytest.mark.check("takes 20 s, by the day")
@pytest.mark.timeout(300)
def test_the_schedules_of_the_day_break_no_invariant(capsys: pytest.CaptureFixture[str]) -> None:
    tally = campaign.Tally(list(campaign.campaign(SEED_OF_THE_DAY, 1.0, processor_s=15.0)))
    with capsys.disabled():
        sys.stdout.write(f"\nseed of the day: {SEED_OF_THE_DAY}; {campaign.speed(tally)}; {dict(tally.broken())}\n")
    assert [text for one in tally.schedules for text in unexpected(one)] == []


# Sessions without faults are tried on other processors in `tests/replay/test_rerun.py`.
@pytest.mark.check("takes 12 s")
@pytest.mark.drawn(0.0, "tests/simulation/", "telenano/virtual/")
def test_a_schedule_gives_the_same_bits_on_other_processors(tmp_path: Path) -> None:
    schedule = tmp_path / "schedule.json"
    schedule.write_text(Schedule.drawn(7).text(), encoding="utf-8")
    command = [sys.executable, "-m", "tests.simulation", "--replay", str(schedule)]
    others = {"OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"}
    said = [
        subprocess.run(command, cwd=ROOT, env={**os.environ, **given}, capture_output=True, text=True).stdout
        for given in ({}, others)
    ]
    assert "sha256" in said[0]
    assert said[0] == said[1]


@pytest.mark.check("takes 6 s, for the fault of the day")
def test_the_planted_fault_of_the_day_is_found() -> None:
    day = SEED_OF_THE_DAY // 1000
    check_found(list(PLANTED)[day % len(PLANTED)], PROCESSES[day // len(PLANTED) % len(PROCESSES)])


@pytest.mark.endurance
@pytest.mark.parametrize("processes", PROCESSES)
@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_breaks_what_it_is_said_to_break_and_nothing_else(name: str, processes: str) -> None:
    check_found(name, processes)


def check_found(name: str, processes: str) -> None:
    fault = PLANTED[name]
    schedule = fault.schedule(processes)
    assert fault.may_show(schedule)
    assert unexpected(tried(schedule)) == []
    with fault.planted():
        broken = {found.invariant for found in tried(schedule).breaks}
    assert broken & fault.breaks
    assert broken <= fault.breaks


def test_every_invariant_has_a_planted_fault() -> None:
    assert {name for fault in PLANTED.values() for name in fault.breaks} == set(INVARIANTS)


def _rows(page: Path, head: str) -> list[list[str]]:
    """Return the cells of the rows of all tables of a page that have this first head."""
    rows, inside = list[list[str]](), False
    for line in page.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        inside = bool(cells) and (inside or cells[0] == head)
        if inside and cells[0] not in (head, "---"):
            rows.append(cells)
    return rows


def test_every_hazard_is_an_invariant_or_says_why_it_is_none() -> None:
    hazards = _rows(ROOT / "docs" / "hazards.md", "hazard")
    told = _rows(HERE / "README.md", "hazard")
    assert [row[0] for row in told] == [row[0] for row in hazards]
    files = {path.name for folder in ("tests", "packages") for path in (ROOT / folder).rglob("test_*.py")}
    for hazard, reason in told:
        named, _, why = reason.partition(";") if reason.startswith("`") else ("", "", reason)
        assert set(re.findall(r"`(\w+)`", named)) <= set(INVARIANTS), hazard
        assert bool(named) or bool(why), hazard
        # A reason is a sentence with the tests that stand in the place of the invariant.
        tests = set(re.findall(r"`(test_\w+\.py)`", why))
        assert bool(tests) == bool(re.search(r"\w+ \w+ \w+", why)), hazard
        assert tests <= files, hazard


def test_every_invariant_is_a_row_of_the_table() -> None:
    assert {row[0].strip("`") for row in _rows(HERE / "README.md", "invariant")} == set(INVARIANTS)


def _short(*events: Event) -> Schedule:
    return Schedule(1, "wave", 0.005, 0.0, events, 50.0)


# What was mended after a schedule had shown it, each with the events that are needed.
MENDED = {
    "a force profile that is started again is judged at its own time": _short(
        {"at_s": 0.776, "kind": "partition", "direction": "forward", "for_s": 0.3},
        {"at_s": 3.0, "kind": "stop"},
    ),
    "a half that was started again takes over a law of which the other half hears only later": _short(
        {"at_s": 0.0, "kind": "clock", "ahead_s": -3600.0, "drift_ppm": 0},
        {"at_s": 1.99, "kind": "stall", "node": LINK, "for_s": 1.0},
        {"at_s": 2.0, "kind": "law", "law": "virtual_impedance"},
        {"at_s": 2.3, "kind": "kill", "node": "controller@master", "after": 0, "torn": 0.0},
    ),
    "a queue that stands before a narrow line is a part of the way": Schedule(
        2,
        "virtual_impedance",
        0.05,
        0.0,
        (
            {"at_s": 4.015, "kind": "stop"},
            {"at_s": 4.466, "kind": "narrow", "direction": "both", "bytes_per_s": 60000.0, "for_s": 1.5},
        ),
        100.0,
    ),
    "a link that was started again tells of no clocks before it knows them": Schedule(
        15000195,
        "wave",
        0.02,
        0.01,
        (
            {"at_s": 0.0, "kind": "clock", "ahead_s": -0.2, "drift_ppm": 0},
            {"at_s": 1.536, "kind": "kill", "node": LINK, "after": 0, "torn": 0.0},
        ),
        100.0,
    ),
    "a reference is not led past one end of the travel by the search for the other": Schedule(
        96200009,
        "passivity",
        0.001,
        0.01,
        (
            {"at_s": 3.138, "kind": "law", "law": "four_channel"},
            {"at_s": 3.679, "kind": "kill", "node": "controller@slave", "after": 0, "torn": 0.0},
            {"at_s": 3.679, "kind": "delay", "forward_s": 0.01, "backward_s": 0.01},
        ),
        250.0,
        force_limit_n=6e-8,
        processes="site",
        session_s=8.5,
    ),
    "the step in which a stop ends a contact is no step of the contact": Schedule(
        96000050,
        "wave",
        0.05,
        0.01,
        ({"at_s": 2.106, "kind": "press", "site": "slave", "target": "afm_node"},),
        100.0,
    ),
    "a tip that the start of the session places was not moved by an earlier arming": Schedule(
        15200063,
        "virtual_impedance",
        0.05,
        0.01,
        ({"at_s": 0.52, "kind": "arm", "target": "tip", "place": False},),
        100.0,
    ),
}


# The nodes of a process of a site, in the order in which it ends them.
TOGETHER = {LINK: [HAND, "controller@master", LINK], TIP: ["controller@slave", TIP]}


@pytest.mark.check("takes 1 s each")
@pytest.mark.parametrize("node", TOGETHER)
@pytest.mark.parametrize("how", ["killed", "ended", "failed", "replaced"])
@pytest.mark.parametrize("processes", PROCESSES)
def test_the_nodes_of_a_process_end_and_come_back_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, processes: str, how: str, node: str
) -> None:
    monkeypatch.setattr(faulty_rig, "_LONGEST_S", 1.2)
    end: Event = {"at_s": 0.6, "kind": "kill", "node": node, "after": 0, "torn": 0.0, "how": how}
    faulty_rig.run(Schedule(1, "wave", 0.005, 0.0, (end,), 50.0, processes=processes), tmp_path / "session")
    acts = json.loads((tmp_path / "session" / "history.json").read_text(encoding="utf-8"))["acts"]
    together = TOGETHER[node] if processes == "site" else [node]
    wanted = "killed" if how == "killed" else "ended"
    ended = [act for act in acts if act["what"] == wanted and act["t_ns"] < 0.7e9]
    again = [act for act in acts if act["what"] == "started" and act["t_ns"] > 0.55e9]
    assert [act["node"] for act in ended] == (together if how != "killed" else sorted(together, key=_built_before))
    assert sorted(act["node"] for act in again) == sorted(together)
    # Who replaces a process does not wait; the launcher waits for a tenth of a second.
    (away_ns,) = {act["t_ns"] - ended[0]["t_ns"] for act in again}
    assert (away_ns < 1e8) == (how == "replaced")


def _built_before(node: str) -> int:
    return [LINK, "controller@master", HAND, "controller@slave", TIP].index(node)


@pytest.mark.check("takes 3 s")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_campaign_that_is_ended_prints_its_tables(tmp_path: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-m", "tests.simulation", "--hours", "10", "--out", str(tmp_path)]
    # Background processes of a shell ignore this signal, and so do their children.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with children.start(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            first = process.stdout.readline()
            process.send_signal(number)
            said, _ = process.communicate(timeout=60)
        finally:
            process.kill()
    assert first.startswith("schedules from the seed 1;")
    assert {line.partition(" ")[0] for line in said.splitlines()} >= set(INVARIANTS)
    assert all(situation in said for situation in SITUATIONS)
    assert process.returncode == 0


def test_the_stamps_of_a_process_never_go_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faulty_rig, "_LONGEST_S", 0.4)
    faulty_rig.run(_short(), tmp_path / "session")
    stamps: dict[str, list[int]] = {}
    for src, _, _, t_ns, _, _ in msgpack.unpackb((tmp_path / "session" / "ledger.msgpack").read_bytes()):
        stamps.setdefault(src, []).append(t_ns)
    assert max(map(len, stamps.values())) > 50
    assert [src for src, each in stamps.items() if each != sorted(each)] == []


@pytest.mark.check("takes 2 s each")
@pytest.mark.parametrize("mended", MENDED)
def test_what_was_mended_breaks_no_invariant(mended: str) -> None:
    assert unexpected(tried(MENDED[mended])) == []


@pytest.mark.endurance
@pytest.mark.parametrize("situation", MADE)
def test_a_situation_that_is_made_is_seen_in_the_recordings(situation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # The rest of the session does not matter.
    monkeypatch.setattr(faulty_rig, "_LONGEST_S", 2.6)
    one = tried(Schedule(3, "wave", 0.005, 0.0, MADE[situation]), reports=False)
    assert situation in one.situations


@pytest.mark.endurance
@pytest.mark.timeout(3600 + 3600 * HOURS)  # An idle processor simulates several hours in one.
def test_hours_of_schedules_break_no_invariant_and_reach_every_situation() -> None:
    tally = campaign.Tally(list(campaign.campaign(SEED_OF_THE_DAY + 500, HOURS)))
    assert [text for one in tally.schedules for text in unexpected(one)] == []
    assert {name for name in SITUATIONS if not tally.reached()[name]} == set()


@pytest.mark.check("takes 3 s for each of the three steps")
@pytest.mark.parametrize(
    ("law", "step_s"), [("wave", (0.02, 0.08)), ("passivity", (0.001, 0.06)), ("virtual_impedance", (0.05, 0.1))]
)
def test_a_step_of_the_delay_holds_the_tip_and_withdraws_nothing(
    tmp_path: Path, step_s: tuple[float, float], law: str
) -> None:
    before_s, after_s = step_s
    step: Event = {"at_s": 2.0, "kind": "delay", "forward_s": after_s, "backward_s": after_s}
    faulty_rig.run(Schedule(31, law, before_s, 0.0, (step,), 250.0), tmp_path)
    (tmp_path / "verdict.json").write_text("{}", encoding="utf-8")
    session = outside_judge.Session(tmp_path)
    (begun_s,) = [one["at_s"] for one in session.events("delay")]
    # Until a person arms again, as the schedule lets one do after all its events.
    modes = {
        device: [(one.sent_s - begun_s, one.fields["mode"]) for one in session.direct[device, topic]]
        for device, topic in ((TIP, "afm/state"), (outside_judge.HAND, "haptic/state"))
    }
    tip = [mode for at_s, mode in modes[TIP] if 0.0 < at_s < 0.6]
    assert set(tip) <= {"follow", "hold"}
    assert tip[-1] == "follow"
    off_s = [at_s for at_s, mode in modes[outside_judge.HAND] if 0.0 < at_s < 0.6 and mode == "off"]
    # The hand comes back within 0.3 s, or as soon as the first answers over the longer way have come for 60 ms.
    assert max(off_s, default=0.0) <= max(0.3, 2.0 * after_s + 0.1)

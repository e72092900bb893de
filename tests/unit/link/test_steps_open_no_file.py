"""The models of instrument, hand, law and link take steps without opening a file."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from link_bench import MS, START, TOPIC, engine, finish

from telenano.lockstep import lockstep, simulation

_armed: list[list[str]] = []
_hooked: list[bool] = []


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    if _armed and event == "open":
        _armed[-1].append(str(arguments[0]))


@contextmanager
def opened_files() -> Iterator[list[str]]:
    """Collect the files that are opened in the block; a hook of the interpreter stays for the life of the process."""
    if not _hooked:
        sys.addaudithook(_note)
        _hooked.append(True)
    _armed.append([])
    try:
        yield _armed[-1]
    finally:
        _armed.pop()


def test_what_is_opened_is_noticed(tmp_path: Path) -> None:
    with opened_files() as opened:
        (tmp_path / "a").write_text("")
    assert opened == [str(tmp_path / "a")]


@pytest.mark.parametrize(
    "forward",
    [
        {"delay_s": 0.02},
        {
            "delay_trace": {"file": "delay.txt"},
            "jitter": {"distribution": "table", "scale_s": 1.0, "table_file": "t.txt"},
        },
        {"loss_trace": {"file": "lost.txt"}, "delivery_trace": {"file": "up.txt"}},
        {"rate": {"rate_bytes_per_s": 50_000}, "outage": {"schedule": "0.01:0.05", "mode": "hold"}},
        {"loss": {"probability": 0.2}, "slots": {"min_interval_s": 0.005}, "gilbert_elliott": {"p": 0.1, "r": 0.3}},
    ],
)  # fmt: skip
def test_a_link_reads_its_files_before_the_first_message(forward: dict[str, Any], tmp_path: Path) -> None:
    for name, text in (("delay.txt", "0 0.01\n1 0.02\n"), ("t.txt", "0.005\n"), ("lost.txt", "0 1\n0.1 0\n"),
                       ("up.txt", "3\n4\n10\n")):  # fmt: skip
        (tmp_path / name).write_text(text)
    link = engine(tmp_path, **forward)
    with opened_files() as opened:
        link.begin_session(START)
        for seq in range(500):
            link.submit(START + seq * MS, TOPIC, bytes(100), seq)
            link.due(START + seq * MS)
        finish(link)
        fates = link.take_fates()
    assert opened == [] and len(fates) >= 500


@pytest.mark.check("runs each law of the core as plain Python for some thousand ticks, two seconds each")
@pytest.mark.drawn(0.5, "telenano/laws/", "telenano/afm/", "telenano/hand/")
@pytest.mark.parametrize("law", ["virtual_impedance", "position_force", "wave", "passivity"])
def test_instrument_hand_and_law_take_their_steps_without_a_file(law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[str]] = []

    def plain(rig: lockstep.Rig, arguments: tuple[Any, ...]) -> tuple[int, int]:
        # The first run imports what it needs.
        lockstep._run(*arguments)
        with opened_files() as opened:
            counts: tuple[int, int] = lockstep._run(*arguments)
        seen.append(opened)
        return counts

    monkeypatch.setattr(lockstep, "_run_as_it_pays", plain)
    simulation.simulate_scenario("fig12", law=law)
    assert seen == [[]]

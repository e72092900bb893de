"""The real bus over each kind of impairment that the link has, and over bursts, beside lockstep over the same link."""

import json
from pathlib import Path
from typing import Any

import machine
import pytest
import yaml
from impairments import KINDS, cell_of, direction_of, outcomes, scenario_over, write_bursts
from stack_rig import SESSIONS
from telenano_lab.studies.loops.cells import Cell, CellResult
from telenano_lab.studies.loops.validate import RECORDING_NAME

from telenano.analysis import Session
from telenano.recording.multi_file import open_recordings

# Servo and clocks leave so much of the balance [J]. Where devices missed their turns their work is summed over longer
# steps, which may leave so large a part of the energy that the sample stores under the hand's newton [1].
LEAST_J, LEAST_HELD_UP = -1e-6, -0.01
# an instrument that answers later than a period, as on a machine that others keep busy, is none of lockstep's
PERIOD_NS = 1_000_000
# A device that has fewer of its turns loses commands as well; after a pause the hand waits for some that are fresh.
LEAST_TURNS = 0.99


def on_the_bus(rig: Any, cell: Cell, kind: dict[str, Any]) -> tuple[CellResult, CellResult]:
    """Run a cell over a kind of link; return what became of it, and in lockstep over what the recording has."""
    scenario: Path = rig.folder / "cell.yaml"
    document = scenario_over(cell, direction_of(kind, rig.folder))
    scenario.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    rig.run(scenario=str(scenario))
    return outcomes(cell, rig.out / RECORDING_NAME)


def held_up(rig: Any) -> str:
    """Say how the machine held up the devices of the last session by what the rig has of itself; empty if it did not.

    Commands that the instrument carried out more than a period after they were sent are counted, and the turns that
    hand and tip had are compared with those that they should have had.
    """
    source = open_recordings([rig.out / RECORDING_NAME])
    session = Session.of(source)
    asked: dict[int, int] = {}
    late = 0
    for message in source.select(lambda c: c.topic in ("afm/command", "afm/state") and c.via == "direct"):
        if message.topic == "afm/command":
            asked[message.seq] = message.publish_ns
        elif (sent_ns := asked.pop(int(message.fields()["command_seq"]), None)) is not None:
            late += session.start_ns <= sent_ns < session.end_ns and message.publish_ns - sent_ns > PERIOD_NS
    completeness = json.loads((rig.out / "summary.json").read_text())["completeness"]
    turns = min(completeness[device] for device in ("afm/state", "haptic/state"))
    found = [f"{late} answers came late"] if late else []
    return " and ".join(found + ([f"a device had {turns:.1%} of its turns"] if turns < LEAST_TURNS else []))


def assert_no_energy_is_made(rig: Any, found: CellResult, stiffness_n_per_m: float) -> None:
    if found.lowest_energy_j <= LEAST_J:
        assert held_up(rig), found
        assert found.lowest_energy_j > LEAST_HELD_UP * 0.5 / stiffness_n_per_m, found


@pytest.mark.endurance
@pytest.mark.parametrize(
    ("law", "messages"),
    [(law, messages) for law in ("wave", "passivity") for messages in (2, 5, 20, 60)],
)
def test_bursts_100_us_apart_make_no_energy_on_the_bus(rig: Any, law: str, messages: int) -> None:
    """On 80 N/m, where a half that took a step for each message made up to -21 mJ after pauses of 60 ms."""
    write_bursts(rig.folder / "delivery.txt", messages)
    for _ in range(SESSIONS):
        found, _ = on_the_bus(rig, cell_of(law, 80.0), KINDS["delivery_trace"])
        # whatever the machine did: no lateness may make energy
        assert_no_energy_is_made(rig, found, 80.0)
        assert found.peak_n is not None
        if not found.guarded and found.peak_n < 1.4 and found.tip_n == pytest.approx(1.0, abs=0.1):
            return
        cause = held_up(rig)
        assert cause, (found.peak_n, found.tip_n, found.guarded_share, found.reason)
    machine.note(
        f"{messages} messages at once under {law}: the force, {found.tip_n:.2f} N at the tip and {found.peak_n:.2f} at "
        f"most, was not judged, because in the last of {SESSIONS} sessions {cause}"
    )

"""UDP blocked between two machines, one way or both: the tip is never withdrawn, and the summary names the way."""

from pathlib import Path

import machine
import pytest
from blocked_cable import Cell, run
from two_sites import needs_namespaces

pytestmark = [needs_namespaces, pytest.mark.timeout(600)]

ATTEMPTS = 3
ONE_WAY = Cell(40.0, "to the master", "at 2 s", 250.0, 0.0, 0.0)


@pytest.mark.drawn(0.0, "telenano/runtime/", "services/")
@pytest.mark.parametrize(
    "cell",
    [
        ONE_WAY,
        pytest.param(ONE_WAY._replace(ways="to the slave"), marks=pytest.mark.endurance),
        pytest.param(ONE_WAY._replace(ways="both ways", loss=0.02), marks=pytest.mark.endurance),
        pytest.param(ONE_WAY._replace(rate_hz=1000.0, round_trip_ms=150.0), marks=pytest.mark.endurance),
    ],
    ids=lambda cell: cell.name,
)
def test_a_block_never_withdraws_the_tip_and_is_named(tmp_path: Path, cell: Cell) -> None:
    for attempt in range(ATTEMPTS):
        found = run(cell, tmp_path / str(attempt), seed=attempt + 1)
        if not found["distorted"]:
            break
        machine.note(f"a session with {cell.name} is not a measurement: {found['distorted']}")
    else:
        pytest.skip(f"{ATTEMPTS} sessions with {cell.name}, and the cable was late in each of them")
    assert not found["tip"]["withdrawn"], found["events"]
    assert found["tip"]["stood_ms"] <= cell.most_ms
    directions = {"both ways": {"forward", "backward"}, "to the slave": {"forward"}, "to the master": {"backward"}}
    assert {line["direction"] for line in found["lines"] if line["blocked_s"]} == directions[cell.ways]

"""Some cells of the sweep of outages on real processes; twenty are `verdict_sweep.py --bus 20`."""

import sys
from pathlib import Path

import pytest
from verdict_sweep import drawn_cells, live


@pytest.mark.timeout(600)
@pytest.mark.endurance
def test_no_verdict_over_an_outage_on_the_bus_contradicts_the_theory(tmp_path: Path) -> None:
    cells = list(live(drawn_cells(5), tmp_path))
    for cell in cells:
        sys.stdout.write(f"{cell}\n")
    assert not [str(cell) for cell in cells if cell.is_wrong]

"""Two machines whose clocks differ: the session has the verdict and the figures of one with a single clock."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from two_sites import TwoSites, needs_namespaces

from analysis.report import write_report
from recording.merge_sites import merge_sites
from services.runtime.loop.clock import EPOCH_OFFSET_VARIABLE

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(300)]


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[TwoSites]:
    found = TwoSites(tmp_path)
    try:
        yield found
    finally:
        found.close()


def set_ahead(rig: TwoSites, ahead_s: float) -> None:
    """Let the clock of the slave's machine be ahead."""
    own_ns = time.time_ns() - time.monotonic_ns()
    rig.slave.environment[EPOCH_OFFSET_VARIABLE] = str(own_ns + round(ahead_s * 1e9))


@pytest.mark.parametrize("ahead_s", [37.0, -0.3])
def test_a_slave_with_another_clock_gives_the_session_of_one_without(rig: TwoSites, ahead_s: float) -> None:
    set_ahead(rig, ahead_s)
    rig.start("--duration", "5")
    assert rig.master.process is not None
    assert rig.master.process.wait(timeout=120) == 0, rig.master.logs()
    rig.slave.stop()
    summary = rig.master.summary()
    assert summary["verdict"] == "stable", summary["holds"]
    assert summary["recording"]["complete"] is True
    assert summary["hold_ratio"] == pytest.approx(1.05, abs=0.005)
    clocks = summary["clocks"]
    assert clocks["applied"] is True
    assert clocks["offset_s"] == pytest.approx(ahead_s, abs=0.01)
    assert "the clocks of the sites are not synchronised" in rig.master.log.read_text()
    both = rig.folder / "both.mcap"
    (far,) = (rig.master.out / "far").iterdir()
    merge_sites([rig.master.out / "session.mcap", far], both)
    merged: dict[str, Any] = write_report(both, rig.folder / "merged")
    assert json.loads((rig.folder / "merged" / "summary.json").read_text()) == merged
    assert merged["verdict"] == "stable"
    assert merged["hold_ratio"] == pytest.approx(summary["hold_ratio"], rel=1e-3)

"""Two machines whose clocks differ: the session has the verdict and the figures of one with a single clock."""

import json
import time
from typing import Any

import pytest
from stack_rig import judged
from two_sites import TwoSites, needs_namespaces

from telenano.analysis.report import write_report
from telenano.recording.site_merge import merge_sites
from telenano.timing.clock import EPOCH_OFFSET_VARIABLE

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(300)]


def set_ahead(sites: TwoSites, ahead_s: float) -> None:
    """Let the clock of the slave's machine be ahead."""
    own_ns = time.time_ns() - time.monotonic_ns()
    sites.slave.environment[EPOCH_OFFSET_VARIABLE] = str(own_ns + round(ahead_s * 1e9))


@pytest.mark.parametrize("ahead_s", [37.0, -0.3])
def test_a_slave_with_another_clock_gives_the_session_of_one_without(sites: TwoSites, ahead_s: float) -> None:
    set_ahead(sites, ahead_s)
    sites.start("--duration", "5")
    assert sites.master.process is not None
    assert sites.master.process.wait(timeout=120) == 0, sites.master.logs()
    sites.slave.stop()
    summary = sites.master.summary()
    undisturbed = judged(summary, f"the session of two clocks {ahead_s} s apart")
    assert summary["verdict"] == "stable" or not undisturbed, summary["holds"]
    assert summary["recording"]["complete"] is True
    assert not undisturbed or summary["hold_ratio"] == pytest.approx(1.05, abs=0.005)
    clocks = summary["clocks"]
    assert clocks["applied"] is True
    assert clocks["offset_s"] == pytest.approx(ahead_s, abs=0.01)
    assert "the clocks of the sites are not synchronised" in sites.master.log.read_text()
    both = sites.folder / "both.mcap"
    (far,) = (sites.master.out / "far").iterdir()
    merge_sites([sites.master.out / "session.mcap", far], both)
    merged: dict[str, Any] = write_report(both, sites.folder / "merged")
    assert json.loads((sites.folder / "merged" / "summary.json").read_text()) == merged
    assert merged["verdict"] == summary["verdict"]
    assert merged["hold_ratio"] == pytest.approx(summary["hold_ratio"], rel=1e-3)

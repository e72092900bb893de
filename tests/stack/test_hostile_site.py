"""A slave's site with a key that lies: its datagrams and messages end or hang no node of the master's site."""

import os
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from two_sites import TwoSites, needs_namespaces

from recording.reader import Recording

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(900)]
HOSTILE = Path(__file__).parents[1] / "fuzz" / "hostile_site"
# TELENANO_FUZZ_S in the environment replaces it, for a longer search
DURATION_S = float(os.environ.get("TELENANO_FUZZ_S", 120.0))


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[TwoSites]:
    made = TwoSites(tmp_path)
    try:
        yield made
    finally:
        made.close()


def test_a_site_with_a_key_that_lies_ends_no_node_of_the_other(rig: TwoSites) -> None:
    rig.slave.environment["PYTHONPATH"] = os.pathsep.join(map(str, (HOSTILE, HOSTILE.parent)))
    rig.slave.start()
    rig.master.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    time.sleep(DURATION_S)
    status = rig.master.telenano("status", "--json")
    assert not rig.master.has_log("launcher@master", "was started again"), rig.master.logs()
    assert not rig.master.has_log("launcher@master", "it hangs and is killed"), rig.master.logs()
    assert "delay_node@master" in status.stdout
    rig.master.stop()
    rig.slave.stop()
    assert "Traceback" not in rig.master.logs()
    network = [message.decode() for message in Recording(rig.master.out / "session.mcap").messages(["link/network"])]
    backward = [report for report in network if report.direction == "backward" and report.src == "delay_node@master"]
    refused = backward[-1].refused
    sys.stdout.write(f"{backward[-1].arrived} datagrams taken, refused {refused}\n")
    assert {"time", "count", "ahead", "malformed"} <= set(refused)
    assert min(refused[cause] for cause in ("time", "count", "ahead", "malformed")) > 0.02 * DURATION_S
    # Reports come twice a second, up to the end: the link never stood still.
    times_ns = [report.t_ns for report in backward]
    assert max(later - earlier for earlier, later in pairwise(times_ns)) < 2_000_000_000

"""A slave's site with a key that lies: its datagrams and messages end or hang no node of the master's site."""

import os
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest
from two_sites import TwoSites, needs_namespaces

from telenano.recording.reader import Recording

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(900)]
HOSTILE = Path(__file__).parents[1] / "fuzz" / "hostile_site"
# TELENANO_FUZZ_S in the environment replaces it, for a longer search
DURATION_S = float(os.environ.get("TELENANO_FUZZ_S", 120.0))


def test_a_site_with_a_key_that_lies_ends_no_node_of_the_other(sites: TwoSites) -> None:
    sites.slave.environment["PYTHONPATH"] = os.pathsep.join(map(str, (HOSTILE, HOSTILE.parent)))
    sites.slave.start()
    sites.master.start("--duration", "600")
    sites.wait_until(sites.running, "a running session")
    time.sleep(DURATION_S)
    status = sites.master.telenano("status", "--json")
    assert not sites.master.has_log("launcher@master", "was started again"), sites.master.logs()
    assert not sites.master.has_log("launcher@master", "it hangs and is killed"), sites.master.logs()
    assert "delay_node@master" in status.stdout
    sites.master.stop()
    sites.slave.stop()
    assert "Traceback" not in sites.master.logs()
    network = [message.decode() for message in Recording(sites.master.out / "session.mcap").messages(["link/network"])]
    backward = [report for report in network if report.direction == "backward" and report.src == "delay_node@master"]
    refused = backward[-1].refused
    # Whatever the other site said, the session has a summary.
    verdict = sites.master.summary()["verdict"]
    sys.stdout.write(f"{backward[-1].arrived} datagrams taken, refused {refused}; verdict {verdict}\n")
    assert {"time", "count", "ahead", "malformed"} <= set(refused)
    assert min(refused[cause] for cause in ("time", "count", "ahead", "malformed")) > 0.02 * DURATION_S
    # Reports come twice a second, up to the end: the link never stood still.
    times_ns = [report.t_ns for report in backward]
    assert max(later - earlier for earlier, later in pairwise(times_ns)) < 2_000_000_000

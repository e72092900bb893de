"""Two machines with a cable between them, and the nodes of each in one process (`realtime.processes: site`)."""

import re
from pathlib import Path
from typing import Any

import pytest
from commands import COMMANDS
from ledger import record
from stack_rig import CONSTANT_PUSH
from two_sites import Site, TwoSites, needs_namespaces

from telenano.wire.nodes import HAND, JOINED, TIP

LINK = "delay_node@master"

pytestmark = [
    needs_namespaces,
    pytest.mark.stack,
    pytest.mark.timeout(600),
    pytest.mark.drawn(0.0, "telenano/runtime/", "telenano/launcher/", "services/site/"),
]


@pytest.fixture
def sites(sites: TwoSites) -> TwoSites:
    sites.master.processes = sites.slave.processes = "site"
    return sites


def newest(site: Site, topic: str) -> Any:
    found = site.recording().messages(topic)
    return found[-1].decode() if found else None


def processes(site: Site) -> dict[str, int]:
    """Give the process of each node of a site that has reported, by its newest report."""
    return {found.src: found.fields()["pid"] for found in site.recording().messages("node/health")}


def coupled(rig: TwoSites) -> bool:
    hand, tip = newest(rig.master, "haptic/state"), newest(rig.slave, "afm/state")
    return hand is not None and tip is not None and hand.mode == "position" and tip.mode == "follow" and tip.in_contact


def test_two_sites_with_a_process_each_press_stop_go_on_and_record(sites: TwoSites) -> None:
    rig = sites
    rig.start("--duration", "3600", "--set", CONSTANT_PUSH)
    rig.wait_until(lambda: coupled(rig), "a hand that presses the tip onto the sample")
    for site, joined in ((rig.master, JOINED["site@master"]), (rig.slave, JOINED["site@slave"])):
        running = processes(site)
        assert len({running[node] for node in joined}) == 1, running
        assert running[f"recorder@{site.name}"] not in {running[node] for node in joined}

    stopped = rig.master.telenano("estop", "--site", "master")
    assert stopped.returncode == 0, stopped.stdout + stopped.stderr
    assert {line.partition(" ")[0] for line in stopped.stdout.splitlines()} == {HAND, TIP}
    rig.wait_until(lambda: newest(rig.slave, "afm/state").mode == "estop", "the tip in emergency stop")
    rig.wait_until(lambda: newest(rig.master, "haptic/state").estop, "the hand in emergency stop")
    rig.rearm()
    rig.wait_until(lambda: newest(rig.slave, "afm/state").mode == "follow", "a tip that follows again")

    summary = rig.end_session()
    assert rig.slave.stop() == 0, rig.slave.logs()
    (both,) = (path for path in rig.master.out.iterdir() if path.name == "both.mcap")
    assert Path(summary["recording"]["file"]).name == both.name
    verified = COMMANDS.run(("bag", "verify", str(both)), rig.master.environment, 60.0)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    for node in ("controller@slave", "controller@master", HAND, TIP, LINK):
        again = COMMANDS.run(("bag", "rerun", str(both), "--node", node), rig.master.environment, 120.0)
        # A console leaves after its command, so the recorder may not have had time to connect to it; a re-run of a node
        # that heard it then ends at that command.
        unheard = re.search(r"lacks session/control, seq \d+ of console@master", again.stdout)
        assert again.returncode == 0 or unheard, again.stdout + again.stderr
    record("two sites over a network, a process each", "pressed, stopped from the master's site, armed, recorded whole")

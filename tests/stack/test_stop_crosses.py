"""An emergency stop at either machine of two goes to both devices, and the command says of each what became of it.

Every other state of the devices is in `tests/unit/console/test_who_is_asked.py`; that the stop crosses in every order
is in `tests/replay/test_virtual_stop_crosses.py`.
"""

import json
import subprocess
from typing import Any

import pytest
from two_sites import TwoSites, needs_namespaces

HAND, TIP = "haptic_node@master", "afm_node@slave"


def kinds(sent: "subprocess.CompletedProcess[str]") -> dict[str, str]:
    return {node: row["kind"] for node, row in json.loads(sent.stdout.splitlines()[-1])["answers"].items()}


def newest(site: Any, topic: str) -> Any:
    return site.recording().messages(topic)[-1].decode()


@needs_namespaces
@pytest.mark.drawn(0.5, "telenano/console/", "services/delay_node/", "telenano/cli/")
def test_a_stop_at_the_instruments_machine_stops_the_hand(sites: TwoSites) -> None:
    rig = sites
    rig.start("--duration", "600")
    # Neither the site nor the rig is named, as by a person in a hurry.
    for arguments in (("estop",), ("session", "estop"), ("estop", "--site", "slave")):
        sent = rig.slave.telenano(*arguments, "--json")
        assert (sent.returncode, kinds(sent)) == (0, {HAND: "ack", TIP: "ack"}), sent.stdout + sent.stderr
        rig.wait_until(lambda: newest(rig.slave, "afm/state").mode == "estop", "the tip in emergency stop")
        rig.wait_until(lambda: newest(rig.master, "haptic/state").estop, "the hand in emergency stop")
        rig.rearm()
    rig.cable.pull()
    for site, own, other in ((rig.slave, TIP, HAND), (rig.master, HAND, TIP)):
        sent = site.telenano("estop", "--json")
        found = kinds(sent)
        assert (sent.returncode, found[own]) == (1, "ack"), sent.stdout + sent.stderr
        # The link keeps it for the instrument; nobody at the instrument's machine keeps one for the hand.
        assert found[other] == ("kept" if other == TIP else "unreached")
    rig.cable.plug()

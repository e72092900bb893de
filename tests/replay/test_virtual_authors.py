"""Each protective act of a device names in its event who made it act, and the value that did."""

from collections.abc import Callable
from contextlib import closing
from typing import Any, NamedTuple

import pytest
from reset_rig import HAND, MASTER_HALF, TIP, ResetRig

from telenano.wire.nodes import LAUNCHER


class Act(NamedTuple):
    """What happens, the device that acts, its mode and reason, the author, and keys of the values behind it."""

    happens: Callable[[ResetRig], Any]
    device: str
    mode: str
    reason: str
    author: str
    values: tuple[str, ...] = ()


def _limited(rig: ResetRig) -> None:
    tip: Any = rig.loops[TIP].node
    tip._limits = tip._instrument._limits = tip._limits._replace(force_limit_n=2e-9)
    rig.press(3.0, 2.4)


ACTS = {
    "an emergency stop at the tip": Act(
        lambda rig: rig.estop(TIP), TIP, "estop", "estop", LAUNCHER
    ),
    "an emergency stop at the hand": Act(
        lambda rig: rig.estop(HAND), HAND, "off", "emergency stop is latched: off until armed", LAUNCHER
    ),
    "a program that withdraws": Act(
        lambda rig: rig.command("stop", "afm_node", because="the session has ended"),
        TIP, "retracting", "retract_requested", LAUNCHER, ("because",),
    ),
    "a hand that is silent, at the tip": Act(
        lambda rig: rig.halt(MASTER_HALF, 0.4), TIP, "hold", "command_deadline", TIP, ("command_age_s", "limit_s")
    ),
    "a silence that goes on": Act(
        lambda rig: rig.halt(MASTER_HALF, 0.8), TIP, "retracting", "hold_expired", TIP, ("command_age_s", "limit_s")
    ),
    "a silence, at the hand": Act(
        lambda rig: rig.halt(MASTER_HALF, 0.4), HAND, "off",
        "no command within the deadline: off until commands are fresh", HAND, ("command_age_s", "limit_s"),
    ),
    "a tip that is pressed too hard": Act(
        _limited, TIP, "retracting", "force_limit", TIP, ("tip_force_n", "limit_n")
    ),
    "an instrument that is lost": Act(
        lambda rig: rig.lose(TIP, lost=True), TIP, "retracting", "device_lost", TIP
    ),
}  # fmt: skip


@pytest.mark.check("takes a second each")
@pytest.mark.parametrize("name", ACTS)
def test_an_act_has_its_author_its_reason_and_the_value_that_caused_it(name: str) -> None:
    act = ACTS[name]
    with closing(ResetRig()) as rig:
        rig.begin()
        rig.press(0.5, 0.5)
        act.happens(rig)
        rig.wait(1.0)
        events = [event for event in rig.events if (event.src, event.kind) == (act.device, "mode")]
        found = [event for event in events if (event.data["mode"], event.data["reason"]) == (act.mode, act.reason)]
        assert found, [(event.data["mode"], event.data.get("reason")) for event in events]
        data = found[-1].data
        assert data["author"] == act.author
        assert set(act.values) <= set(data)
        if "limit_s" in act.values:
            assert data["command_age_s"] > data["limit_s"]
        if "limit_n" in act.values:
            assert data["tip_force_n"] > data["limit_n"]
        # What the data say the sentence says.
        assert act.author == act.device or act.author in found[-1].text
        assert str(data.get("because", "")) in found[-1].text

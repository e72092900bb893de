"""An emergency stop given at one site crosses to the other, in virtual time; devices and link are the real ones.

A sender at the instrument's site reaches the instrument alone, whose answer carries the stop over the link.
"""

from typing import Any

import msgspec
import pytest

from telenano.virtual import VirtualRig
from telenano.wire import encode
from telenano.wire.messages import SessionControl, SessionEvent

HAND, TIP, LINK = "haptic_node@master", "afm_node@slave", "delay_node@master"
# Time of the stop, and a time by which every device has obeyed it [s].
STOPPED_S, OBEYED_S = 1.0, 2.0
SLOW = ("delay_node.forward.delay_s=0.05", "delay_node.backward.delay_s=0.05")


class Rig(VirtualRig):
    """A rig whose instrument gets emergency stops at its own inlet."""

    def stop_at(self, device: str, target: str, identifier: str) -> None:
        """Bring a stop to the inlet of a device, as a sender of its site does."""
        now_ns = self.clock.now_ns()
        stop = SessionControl(
            seq=0, t_ns=now_ns, src=f"estop@{device.partition('@')[2]}", v=1, id=identifier, command="estop",
            target=target, parameters={},
        )  # fmt: skip
        self._put(device, "session/control", encode(stop), stop, self.clock.monotonic_ns())

    def newest(self, topic: str, src: str) -> Any:
        return self._published[topic, src][-1]

    def answers(self, device: str, identifier: str) -> list[SessionEvent]:
        events: list[Any] = self._published.get(("session/event", device), [])
        return [event for event in events if event.id == identifier and event.kind == "ack"]


def armed(seed: int, *settings: str) -> Rig:
    rig = Rig(None, seed, ("realtime.rate_hz=250", *settings))
    rig.run_until(0.2)
    rig.command("arm", "*", place="hand")
    rig.run_until(0.4)
    rig.command("start", "haptic_node")
    rig.run_until(STOPPED_S)
    assert rig.newest("haptic/state", HAND).armed and rig.newest("afm/state", TIP).mode == "follow"
    return rig


@pytest.mark.check("each runs a rig for half a second")
@pytest.mark.parametrize("settings", [(), SLOW], ids=["at once", "a slow line"])
@pytest.mark.parametrize(
    ("target", "stops_hand"), [("*", True), ("*_node", True), ("afm_node", False), ("*@slave", False)]
)
def test_a_stop_at_the_instrument_stops_the_hand_if_it_is_meant(
    target: str, stops_hand: bool, settings: tuple[str, ...]
) -> None:
    rig = armed(7, *settings)
    rig.stop_at(TIP, target, "s-1")
    rig.run_until(OBEYED_S)
    assert rig.newest("afm/state", TIP).mode == "estop"
    assert rig.newest("haptic/state", HAND).estop is stops_hand
    assert bool(rig.answers(HAND, "s-1")) is stops_hand


@pytest.mark.check("each runs a rig for four seconds of its time")
@pytest.mark.parametrize("away", [HAND, LINK, TIP])
def test_a_stop_waits_for_who_stands_still(away: str) -> None:
    rig = armed(8)
    rig.stall(away, 1.5)
    rig.stop_at(TIP, "*", "s-1")
    rig.run_until(STOPPED_S + 3.0)
    assert rig.newest("afm/state", TIP).mode == "estop" and rig.newest("haptic/state", HAND).estop
    assert len(rig.answers(HAND, "s-1")) >= 1


@pytest.mark.check("runs a rig for three seconds of its time")
def test_an_answer_that_comes_again_stops_no_hand_that_was_armed_since() -> None:
    rig = armed(9)
    for device in (HAND, TIP):
        rig.stop_at(device, "*", "s-1")
    rig.run_until(STOPPED_S + 0.5)
    assert rig.newest("haptic/state", HAND).estop
    # A person arms the hand, who knows of the stop; then the instrument, which was started again, obeys it once more.
    rig.command("arm", "haptic_node")
    rig.run_until(STOPPED_S + 0.6)
    latch = rig.newest("session/event", HAND).data["latch"]
    arm = msgspec.structs.replace(_arm(rig), node_latch={HAND: latch})
    rig._put(HAND, "session/control", encode(arm), arm, rig.clock.monotonic_ns())
    rig.run_until(STOPPED_S + 0.8)
    assert rig.newest("haptic/state", HAND).armed
    rig.stop_at(TIP, "*", "s-1")
    rig.run_until(STOPPED_S + 1.5)
    assert len(rig.answers(TIP, "s-1")) == 2
    assert rig.newest("haptic/state", HAND).armed, "it has obeyed this stop already"
    # A new stop is another matter.
    rig.stop_at(TIP, "*", "s-2")
    rig.run_until(STOPPED_S + 2.0)
    assert rig.newest("haptic/state", HAND).estop


def _arm(rig: Rig) -> SessionControl:
    return SessionControl(
        seq=10**6, t_ns=rig.clock.now_ns(), src="console@master", v=1, id="a-1", command="arm", target="haptic_node",
        parameters={},
    )  # fmt: skip

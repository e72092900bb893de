"""A rig whose processes were killed or stood still, and how a person takes it up again."""

import time
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from stack_rig import Rig

from telenano.recording.messages import RecordedMessage

RESTARTED = "was started again"
# generous against the 50 ms and 250 ms of the design: this machine may be busy, the order of things may not change
SOON_NS = 1_000_000_000


class Kill(NamedTuple):
    node: str
    at_ns: int


STATE_OF = {"afm_node@slave": "afm/state", "haptic_node@master": "haptic/state"}


def after_restart(messages: Sequence[RecordedMessage]) -> RecordedMessage | None:
    """Give the first message of a publisher that has begun to number anew."""
    return next((after for before, after in pairwise(messages) if after.seq < before.seq), None)


def recover(rig: Rig, kill: Kill, times: int = 1) -> None:
    """Wait for the supervisor, then take the rig up again as an operator would who sees what the recorder receives.

    The process has been started again so many times then.
    """
    mates = rig.mates_of(kill.node)
    for node in mates:
        text = f"{node} {RESTARTED}"
        rig.wait_until(lambda text=text: rig.log_has("launcher@master", text, times), f"the restart of {node}")
    for node in mates:
        if topic := STATE_OF.get(node):
            before_ns = kill.at_ns - SOON_NS // 2
            rig.wait_until(
                lambda topic=topic, before_ns=before_ns: (
                    after_restart(rig.recording().messages(topic, before_ns)) is not None
                ),
                f"the state of {node}",
            )

    def armed() -> bool:
        return rig.telenano("session", "arm", "--target", "afm_node").returncode == 0

    rig.wait_until(armed, "an AFM that can be armed again")
    if "haptic_node@master" in mates:
        assert rig.telenano("session", "start", "--target", "haptic_node").returncode == 0
    # the hand follows again once its commands are there
    rig.wait_until(lambda: rig.telenano("session", "arm", "--target", "haptic_node").returncode == 0, "an armed hand")


def coupled(rig: Rig) -> bool:
    """Return whether both devices are in their modes for the last second that is recorded, so that a kill ends them.

    A tip that was armed while it held, and withdrew as its hold ended, is armed again as an operator would.
    """
    newest = rig.recording().messages("afm/state", time.time_ns() - SOON_NS)
    if newest and newest[-1].decode().mode == "retracted":
        rig.telenano("session", "arm", "--target", "afm_node")
    for topic, mode in (("haptic/state", "position"), ("afm/state", "follow")):
        found = rig.recording().messages(topic, time.time_ns() - 3 * SOON_NS)
        if not found or found[-1].publish_ns - found[0].publish_ns < SOON_NS:
            return False
        last = [message for message in found if message.publish_ns >= found[-1].publish_ns - SOON_NS]
        if {message.decode().mode for message in last} != {mode}:
            return False
    return True

"""Commands to begin a session: arm the hand, arm the tip and place it at the hand, wait until it is there, and start.

    client = CommandClient(clock, publish, (ARM_HAND, PLACE_TIP, START))

Console, page and launcher use those of these commands that they need. Safety does not rely on their order: a tip
follows only an armed hand (`telenano.afm.safety`). The hand comes first, because the instrument reports the tip as
placed once it follows the hand.

`ARM` moves nothing: tip and hand stay where they are. Only a parameter of the tip's `arm` lets the tip approach the
sample: to the hand at the start of a session (`PLACE_TIP`), or back to a given place (`return_to`).
"""

from dataclasses import replace

from telenano.runtime.loop.commands import Command
from telenano.wire.nodes import HAND, TIP, name_of

ARM_HAND = Command("arm", name_of(HAND), (HAND,))
ARM_TIP = Command("arm", name_of(TIP), (TIP,), placed=True)
ARM = (ARM_HAND, ARM_TIP)
# The command of a person who begins a session: it moves the tip to the place of the hand, once.
PLACE_TIP = replace(ARM_TIP, parameters={"place": "hand"})
START = Command("start", "*", (HAND,))
# Time for an answer from a program that stands in for the hand [ns]; a played recording does not answer.
_STAND_IN_NS = 500_000_000


def return_to(place_m: float, speed_m_per_s: float) -> Command:
    """Return the command that moves the tip back to a place [m], positive towards the sample, at a speed [m/s].

    Any input ends the motion: another command, or a hand that moves or presses.
    """
    return replace(ARM_TIP, parameters={"place_m": place_m, "speed_m_per_s": speed_m_per_s})


def for_stand_in(command: Command) -> Command:
    """Return a command for a program that publishes instead of a node, and which need not answer."""
    return replace(command, required=False, deadline_ns=_STAND_IN_NS)

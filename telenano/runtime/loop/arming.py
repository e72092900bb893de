"""How a session begins: arm the hand, arm the tip and let it go to the hand, wait until it is there, start the program.

    client = CommandClient(clock, publish, (ARM_HAND, PLACE_TIP, START))

Console, page and launcher take these commands, each as many of them as it needs. Nothing relies on their order: a tip
follows only an armed hand (`telenano.afm.safety`). The hand comes first because the instrument reports that the
tip is placed once it follows.

`ARM` starts nothing: tip and hand stay where they are. Only a word in the parameters of the tip's `arm` lets it go
towards the sample: to the hand at the start of a session (`PLACE_TIP`), or back to a stated place (`return_to`).
"""

from dataclasses import replace

from telenano.runtime.loop.commands import Command
from telenano.wire.nodes import HAND, TIP, name_of

ARM_HAND = Command("arm", name_of(HAND), (HAND,))
ARM_TIP = Command("arm", name_of(TIP), (TIP,), placed=True)
ARM = (ARM_HAND, ARM_TIP)
# A person who begins a session orders the tip to the place of the hand, once.
PLACE_TIP = replace(ARM_TIP, parameters={"place": "hand"})
START = Command("start", "*", (HAND,))
# A program that stands in for the hand has this long to answer [ns], and need not: a recording does not.
_STAND_IN_NS = 500_000_000


def return_to(place_m: float, speed_m_per_s: float) -> Command:
    """Return the command that lets the tip go back to a place, towards the sample > 0 [m], at a speed [m/s].

    Any input ends it: another command, and a hand that moves or presses.
    """
    return replace(ARM_TIP, parameters={"place_m": place_m, "speed_m_per_s": speed_m_per_s})


def for_stand_in(command: Command) -> Command:
    """Return a command for whatever publishes in the place of a node, which may answer it and need not."""
    return replace(command, required=False, deadline_ns=_STAND_IN_NS)

"""How a session begins: arm the hand, arm the tip, wait until the tip is placed, start the operator's program.

    client = CommandClient(clock, publish, (*ARM, START))

Console, page and launcher take these commands, each as many of them as it needs. Nothing relies on their order: a tip
follows only an armed hand (`telenano.afm.safety`). The hand comes first because the instrument reports that the
tip is placed once it follows.
"""

from dataclasses import replace

from telenano.runtime.loop.commands import Command
from telenano.wire.nodes import HAND, TIP, name_of

ARM_HAND = Command("arm", name_of(HAND), (HAND,))
ARM_TIP = Command("arm", name_of(TIP), (TIP,), placed=True)
ARM = (ARM_HAND, ARM_TIP)
START = Command("start", "*", (HAND,))
# A program that stands in for the hand has this long to answer [ns], and need not: a recording does not.
_STAND_IN_NS = 500_000_000


def for_stand_in(command: Command) -> Command:
    """Return a command for whatever publishes in the place of a node, which may answer it and need not."""
    return replace(command, required=False, deadline_ns=_STAND_IN_NS)

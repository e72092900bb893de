"""The programs of examples/ that have a rig: of each, the texts and figures that it prints, whatever the moment."""

import re
from typing import NamedTuple


class Printed(NamedTuple):
    """What a line begins with, the figure after it, and how far it may be off."""

    beginning: str
    figure: float
    tolerance: float


# One rig, whose hand presses with 1 N, runs beside each of these.
BESIDE_A_RIG: dict[str, tuple[Printed, ...]] = {
    "bare_client": (Printed("greatest_nn", 9.524, 0.2),),
    "live_plot": (
        Printed("haptic/state messages [0-9]+ greatest_n", 1.0, 0.001),
        Printed("afm/state messages [0-9]+ greatest_n", 0.9524, 0.02),
    ),
}
# These start a rig of their own.
WITH_A_RIG: dict[str, tuple[Printed, ...]] = {
    "own_device": (
        Printed("from_s 3 scaled_tip_force_n", 0.9524, 0.02),
        Printed("from_s 6 scaled_tip_force_n", 1.9048, 0.04),
    ),
}


def assert_printed(printed: str, expected: tuple[Printed, ...]) -> None:
    """Check that each figure stands once behind what its line begins with, and is as expected."""
    for line in expected:
        (found,) = re.findall(rf"^{line.beginning} (-?[\d.]+)", printed, re.MULTILINE)
        assert abs(float(found) - line.figure) <= line.tolerance, (line, found)

"""The programs of examples/ that use a rig, with the texts and numbers that each must print in every run."""

import re
from typing import NamedTuple


class Printed(NamedTuple):
    """The beginning of a line (a regular expression), the number after it, and the tolerance of that."""

    beginning: str
    figure: float
    tolerance: float


# Programs that run beside a rig whose hand presses with 1 N.
BESIDE_A_RIG: dict[str, tuple[Printed, ...]] = {
    "bare_client": (Printed("greatest_nn", 9.524, 0.2),),
    "live_plot": (
        Printed("haptic/state messages [0-9]+ greatest_n", 1.0, 0.001),
        Printed("afm/state messages [0-9]+ greatest_n", 0.9524, 0.02),
    ),
}
# Programs that start a rig themselves.
WITH_A_RIG: dict[str, tuple[Printed, ...]] = {
    "own_device": (
        Printed("from_s 3 scaled_tip_force_n", 0.9524, 0.02),
        Printed("from_s 6 scaled_tip_force_n", 1.9048, 0.04),
    ),
}


def assert_printed(printed: str, expected: tuple[Printed, ...]) -> None:
    """Check that each number appears once after the beginning of its line, and is within its tolerance."""
    for line in expected:
        (found,) = re.findall(rf"^{line.beginning} (-?[\d.]+)", printed, re.MULTILINE)
        assert abs(float(found) - line.figure) <= line.tolerance, (line, found)

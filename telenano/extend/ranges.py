"""Ranges of the parameters of the laws: wider than any hand and instrument need, and so that no step overflows.

    stiffness_n_per_m: float = parameter(1500.0, "N/m", "Stiffness of the spring K_0 [N/m]")

The steps multiply a handful of these with quantities of the wire, which have ranges of their own
(`telenano.wire.ranges`). With every factor between 1e-15 and 1e15 the products, summed over any session, stay far below
the 1.8e308 of a double.
"""

from typing import Any

from pydantic import Field

# least and greatest value of a parameter by its unit
_RANGES = {
    # scale of positions, from a metre at the hand to a picometre at the tip, and up to 1000 for the larger slave
    "m/m": (1e-12, 1e3),
    # scale of forces, up to a newton at the hand for a femtonewton at the tip
    "N/N": (1e-3, 1e15),
    # The range goes from a milligram to a thousand tonnes.
    "kg": (1e-6, 1e6),
    # the heaviest hand is a few thousand N s/m; a rigid one is 1e9
    "N s/m": (1e-6, 1e9),
    # the stiffest environment that an AFM can be given has 1e9 N/m
    "N/m": (1e-6, 1e9),
    # 4/3 E* sqrt(R): diamond and a radius of 1 mm have 5e10
    "N/m^1.5": (1e-3, 1e15),
    # gains and rates
    "1": (0.0, 1e9),
    # The range goes from a microsecond to eleven days.
    "s": (1e-6, 1e6),
    # the ranges of the wire, and nothing
    "N": (0.0, 1e6),
    "sqrt(W)": (0.0, 1e6),
    "m/s": (1e-12, 1e3),
    # The range begins at a thousandth of a picometre.
    "m": (1e-15, 1.0),
    "J": (1e-15, 1e9),
    "N/s": (1e-9, 1e9),
    "N/(m s)": (1e-6, 1e15),
}


def parameter(default: float, unit: str, description: str, *, zero: bool = False) -> Any:
    """Return the field of a parameter of a law, whose range follows from its unit.

    Args:
        default: The default, in the unit.
        unit: The unit, as in `_RANGES`: 1 for a gain or a rate.
        description: What it is, with its unit.
        zero: Whether it may be zero, where the range of the unit begins above it.

    Raises:
        KeyError: No range is known of the unit.
    """
    least, most = _RANGES[unit]
    return Field(default=default, ge=0.0 if zero else least, le=most, description=description)

"""Ranges of the laws' parameters, wider than any hand or instrument needs, but such that no step overflows.

    stiffness_n_per_m: float = parameter(1500.0, "N/m", "Stiffness of the spring K_0 [N/m]")

The steps multiply a few of them with quantities of the wire, which have their own ranges (`telenano.wire.ranges`). With
every factor between 1e-15 and 1e15 the products, summed over any session, stay far below the 1.8e308 of a double.
"""

from typing import Any

from pydantic import Field

# Least and greatest value of a parameter, by its unit.
_RANGES = {
    # Position scale: from a picometre at the tip per metre at the hand, up to 1000 for a larger slave.
    "m/m": (1e-12, 1e3),
    # Force scale: up to a newton at the hand per femtonewton at the tip.
    "N/N": (1e-3, 1e15),
    # From a milligram to a thousand tonnes.
    "kg": (1e-6, 1e6),
    # The most damped hand has a few thousand N s/m; 1e9 is a rigid one.
    "N s/m": (1e-6, 1e9),
    # The stiffest environment of an AFM setting has 1e9 N/m.
    "N/m": (1e-6, 1e9),
    # 4/3 E* sqrt(R): diamond and a radius of 1 mm have 5e10
    "N/m^1.5": (1e-3, 1e15),
    # Gains and rates.
    "1": (0.0, 1e9),
    # From a microsecond to eleven days.
    "s": (1e-6, 1e6),
    # The ranges of the wire, including zero.
    "N": (0.0, 1e6),
    "sqrt(W)": (0.0, 1e6),
    "m/s": (1e-12, 1e3),
    # From a thousandth of a picometre.
    "m": (1e-15, 1.0),
    "J": (1e-15, 1e9),
    "N/s": (1e-9, 1e9),
    "N/(m s)": (1e-6, 1e15),
}


def parameter(default: float, unit: str, description: str, *, zero: bool = False) -> Any:
    """Return the field of a parameter of a law, whose range follows from its unit.

    Args:
        default: The default, in the unit.
        unit: The unit, a key of `_RANGES`: 1 for a gain or a rate.
        description: The description, with the unit.
        zero: Whether the parameter may be 0 even if the range of the unit begins above.

    Raises:
        KeyError: The unit has no range.
    """
    least, most = _RANGES[unit]
    return Field(default=default, ge=0.0 if zero else least, le=most, description=description)

"""Whether a measurement tells a value that is stated with an error, such as a stiffness, a modulus or a time.

    if reason := denied("the stiffness", 12.5, 9.4, "N/m"):
        raise NoEstimateError(f"{reason}: take more averages")

An error that is a large share of a value that cannot be zero denies the value: it is then a guess with a unit. A value
that may be zero, such as an adhesion or an effect between people, is no matter of this; it stands with its interval.
"""

import math

# The greatest standard error of a value that cannot be zero, as a share of it.
GREATEST_SHARE = 0.3
# A value this near to an end of its range, as a share of it, is that end.
_AT_END = 1e-3
# A peak stands out if it is higher than this number of times the scatter beside it.
_STANDS_OUT = 3.0
# A text states this number of significant digits.
_DIGITS = 4


def denied(
    what: str,
    value: float,
    error: float,
    unit: str = "",
    *,
    ends: tuple[float, float] | None = None,
    others: tuple[float, ...] = (),
    above_scatter: float = math.inf,
    points: tuple[int, int] | None = None,
) -> str:
    """Return why a value above zero is no estimate, as the begin of a sentence; empty if it is one.

    Args:
        what: The quantity, with its article.
        value: The value, above 0, in the unit.
        error: Its standard error, in the unit.
        unit: The unit; empty for none.
        ends: The range in which it was sought; a value at one of its ends was not found.
        others: Values of other optima that describe the data as well.
        above_scatter: The height of the peak that shows it, in multiples of the scatter of its points.
        points: How many points or turns tell it, and how many are needed.
    """
    unit = f" {unit}" if unit else ""
    if points is not None and points[0] < points[1]:
        return f"{points[0]} points tell {what}, and {points[1]} are needed"
    if not (value > 0.0 and math.isfinite(value)):
        return f"nothing tells {what}"
    if ends is not None and not ends[0] * (1.0 + _AT_END) < value < ends[1] * (1.0 - _AT_END):
        end = min(ends, key=lambda one: abs(one - value))
        return f"the fit of {what} ends at the end of its range, {end:.{_DIGITS}g}{unit}"
    if above_scatter < _STANDS_OUT:
        return f"the peak that would tell {what} is {above_scatter:.2g} times as high as its lines scatter"
    other = max(others, key=lambda one: abs(one - value), default=value)
    if abs(other - value) > GREATEST_SHARE * value:
        return f"{what} may be {value:.{_DIGITS}g}{unit} or {other:.{_DIGITS}g}{unit}, which describe it as well"
    if not error <= GREATEST_SHARE * value:
        known = f"an error of {100.0 * error / value:.0f} %" if math.isfinite(error) else "no bound of its error"
        return f"{what} would be {value:.2g}{unit} with {known}, which is no estimate"
    return ""

"""Exponentials, logarithms and sums whose bits do not depend on the processor.

NumPy and the C library choose kernels by the instruction set of the processor, and these differ in the last digit (ADR
0010). The level of the next trial depends on such numbers and is kept in the journal of an experiment, so they are
computed only with additions, multiplications and divisions, which IEEE 754 rounds uniquely, in a fixed order.
"""

import math

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]

_LN2 = 0.6931471805599453
# The upper part of ln 2 has so few digits that its integer multiples are exact.
_LN2_HIGH = 6.93147180369123816490e-01
# The rest of ln 2.
_LN2_LOW = 1.90821492927058770002e-10
# The coefficients of the power series of exp x.
_EXPONENTIAL = [1.0 / math.factorial(power) for power in range(14)]
# The coefficients of the power series of artanh x, over the odd powers.
_LOGARITHM = [1.0 / (2 * power + 1) for power in range(12)]
# The square root of 0.5.
_ROOT_HALF = 0.7071067811865476
# Arguments of the exponential are clipped here, where it is still finite.
_LARGEST = 700.0
# Beyond this number of standard deviations the share is practically 0 or 1.
_FARTHEST = 7.0
_TERMS = 90
_DENSITY = 0.3989422804014327


def exp(values: Numbers) -> Numbers:
    """Return the exponentials of values, which are clipped to ±700."""
    bounded = np.clip(values, -_LARGEST, _LARGEST)
    power = np.rint(bounded / _LN2)
    rest = (bounded - power * _LN2_HIGH) - power * _LN2_LOW
    return np.ldexp(_polynomial(_EXPONENTIAL, rest), power.astype(np.int32))


def log(values: Numbers) -> Numbers:
    """Return the natural logarithms of positive numbers."""
    mantissa, exponent = np.frexp(values)
    is_low = mantissa < _ROOT_HALF
    mantissa = np.where(is_low, 2.0 * mantissa, mantissa)
    ratio = (mantissa - 1.0) / (mantissa + 1.0)
    return (exponent - is_low) * _LN2 + 2.0 * ratio * _polynomial(_LOGARITHM, ratio * ratio)


def normal_share(values: Numbers) -> Numbers:
    """Return the share of standard normal numbers below each value.

    G. Marsaglia, J. Stat. Softw. 11 (2004) 4: 1/2 + density · (z + z³/3 + z⁵/(3·5) + …).
    """
    z = np.clip(values, -_FARTHEST, _FARTHEST)
    square, term, series = z * z, z.copy(), z.copy()
    for odd in range(3, 2 * _TERMS, 2):
        term = term * square / odd
        series = series + term
    return np.clip(0.5 + _DENSITY * exp(-0.5 * square) * series, 0.0, 1.0)


def total(values: Numbers) -> Numbers:
    """Return the sums along the last axis, by adding elements half the length apart until one is left."""
    while values.shape[-1] > 1:
        half = values.shape[-1] // 2
        odd = values[..., 2 * half :]
        values = values[..., :half] + values[..., half : 2 * half]
        if odd.shape[-1]:
            values = np.concatenate([values, odd], axis=-1)
    return values[..., 0]


def _polynomial(coefficients: list[float], values: Numbers) -> Numbers:
    result = np.full_like(values, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        result = result * values + coefficient
    return result

"""The force on a tip from its frequency shift: the inversion of Sader and Jarvis, over whole curves.

    F(D) = 2 k / f0 int_D^inf [(1 + sqrt(A) / (8 sqrt(pi (z - D)))) df(z) - A^(3/2) / sqrt(2 (z - D)) df'(z)] dz

(Sader and Jarvis, Appl. Phys. Lett. 84, 1801, 2004). From the place of the greatest attraction outwards the error is a
few percent of that attraction, for any amplitude A; on the repulsive flank it is 5 to 35 %. D is the distance of
closest approach. A curve has to reach out to where its shift no longer changes, which is assumed to be 0. Where the
force turns sharply within an amplitude, no inversion is reliable (Sader, Hughes, Huber and Giessibl, Nat. Nanotechnol.
13, 1088, 2018). Between its points the shift is interpolated linearly, so that the integrals are those of roots.
"""

import math
from typing import Any

import numpy as np

from telenano.extend.maps import Array
from telenano_lab.afm_files.force_map import ForceMap, MapError

# Constants that are needed besides the stiffness of the sensor.
ASKED = ("resonance_hz", "amplitude_m")
# The shift still changes if it varies at the far end by more than this share of its greatest attraction.
_STANDS = 0.05
# The far end is the last of this number of parts of a curve.
_FAR = 10


def as_force(recorded: ForceMap, constants: dict[str, Any]) -> ForceMap:
    """Convert a map of a frequency shift to a map of the force.

    Args:
        recorded: The map of the shift [Hz], with ascending heights.
        constants: stiffness_n_per_m, resonance_hz and amplitude_m of the sensor.

    Raises:
        MapError: It is a map of another quantity, a number is missing, or its curves do not reach far enough.
    """
    if recorded.quantity != "frequency_shift":
        raise MapError(f"--as force: is for a frequency shift; this is a map of {recorded.quantity}")
    numbers = []
    for name in ("stiffness_n_per_m", *ASKED):
        value = constants.get(name)
        if not (isinstance(value, int | float) and 0.0 < value < math.inf):
            fault = "is missing" if value is None else f"is {value!r}"
            raise MapError(f"{name}: {fault}; --as force needs it as a number above 0 (--set {name}=…)")
        numbers.append(float(value))
    stiffness, resonance_hz, amplitude_m = numbers
    far = recorded.values[..., -max(len(recorded.z_m) // _FAR, 2) :]
    # Twice the difference of the means of both halves of the far end, which averages out the noise.
    middle = far.shape[-1] // 2
    change = 2.0 * np.abs(far[..., middle:].mean(axis=-1) - far[..., :middle].mean(axis=-1))
    standing = recorded.values - far.mean(axis=-1, keepdims=True)
    # A missing tail falsifies the attraction; a curve with hardly any attraction is judged by its repulsion.
    most = np.maximum(-standing.min(axis=-1), 0.02 * np.abs(standing).max(axis=-1))
    if (change > _STANDS * most).any():
        worst = float((change / np.where(most > 0.0, most, 1.0)).max())
        raise MapError(
            f"value: the frequency shift still changes by {100.0 * worst:.0f} % of its greatest attraction in the"
            " farthest tenth of a curve: --as force needs curves that reach to where it stands"
        )
    weights = (2.0 * stiffness / resonance_hz) * weights_of(
        len(recorded.z_m), recorded.z_m[1] - recorded.z_m[0], amplitude_m
    )
    forces = np.einsum("ij,...j->...i", weights, standing)
    return recorded._replace(values=forces, quantity="force", stiffness_n_per_m=stiffness)


def weights_of(points: int, step_m: float, amplitude_m: float) -> Array:
    """Return the integral as a matrix, shape (points, points), that acts on a shift at even heights [m]."""
    begin = step_m * np.arange(points - 1)
    end = begin + step_m
    roots = 2.0 * (np.sqrt(end) - np.sqrt(begin))
    moment = (2.0 / 3.0) * (end**1.5 - begin**1.5) - begin * roots
    near, slope = (
        math.sqrt(amplitude_m) / (8.0 * math.sqrt(math.pi)),
        amplitude_m**1.5 / math.sqrt(2.0) * roots / step_m,
    )
    # Weights of the beginning and the end of each interval, by its distance from the closest approach.
    first = 0.5 * step_m + near * (roots - moment / step_m) + slope
    last = 0.5 * step_m + near * moment / step_m - slope
    weights = np.zeros((points, points))
    for i in range(points - 1):
        weights[i, i : points - 1] += first[: points - 1 - i]
        weights[i, i + 1 :] += last[: points - 1 - i]
    return weights

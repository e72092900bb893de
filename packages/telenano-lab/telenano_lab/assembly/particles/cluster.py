"""The motion of pushed particles that touch each other: the one with the least dissipation.

The displacements D_i of a step minimize the sum of F_i |D_i| subject to (D_j - D_i) . n_ij >= -gap for each pair, and
e . D_i >= overlap for each particle that the tip pushes; the multipliers of these conditions are the forces. The
problem is solved by projected Gauss-Seidel on squares whose weights F_i / |D_i| are updated: once the weights have
settled, the weighted problem has the same minimum.
"""

import numpy as np
import numpy.typing as npt

from telenano.numerics import compiled
from telenano_lab.assembly.particles.tip_shape import distance_m

Array = npt.NDArray[np.float64]

_REWEIGHTINGS = 30
_SWEEPS = 20
# A particle at rest has the weight of one that moves by this share of the step.
_STANDS = 1e-4


@compiled
def give_way(force_n: Array, pairs: Array, pushes: Array, displacement_m: Array, reaction_n: Array) -> None:
    """Write the displacements [m] of least dissipation and the corresponding forces of the tip [N].

    Args:
        force_n: Force that moves each particle [N], shape (n,); infinite for a fixed one.
        pairs: Shape (p, 5): numbers i and j, the normal from i to j, the gap between them [m].
        pushes: Shape (t, 4) or wider: number of a particle that the tip pushes, direction, overlap with the tip [m].
        displacement_m: Shape (n, 2), written.
        reaction_n: Shape (t,), written.
    """
    n, p, t = force_n.shape[0], pairs.shape[0], pushes.shape[0]
    step_m = 0.0
    for c in range(t):
        step_m = max(step_m, pushes[c, 3])
    mobility = np.empty(n)
    tension = np.zeros(p)
    for i in range(n):
        mobility[i] = step_m / force_n[i]
        displacement_m[i, 0] = displacement_m[i, 1] = 0.0
    for c in range(t):
        reaction_n[c] = 0.0
    for _ in range(_REWEIGHTINGS):
        for i in range(n):
            displacement_m[i, 0] = displacement_m[i, 1] = 0.0
        for c in range(t):
            i = int(pushes[c, 0])
            displacement_m[i, 0] += mobility[i] * reaction_n[c] * pushes[c, 1]
            displacement_m[i, 1] += mobility[i] * reaction_n[c] * pushes[c, 2]
        for c in range(p):
            i, j = int(pairs[c, 0]), int(pairs[c, 1])
            displacement_m[i, 0] -= mobility[i] * tension[c] * pairs[c, 2]
            displacement_m[i, 1] -= mobility[i] * tension[c] * pairs[c, 3]
            displacement_m[j, 0] += mobility[j] * tension[c] * pairs[c, 2]
            displacement_m[j, 1] += mobility[j] * tension[c] * pairs[c, 3]
        for _ in range(_SWEEPS):
            for c in range(t):
                i = int(pushes[c, 0])
                if mobility[i] <= 0.0:
                    continue
                along = displacement_m[i, 0] * pushes[c, 1] + displacement_m[i, 1] * pushes[c, 2]
                after = max(reaction_n[c] + (pushes[c, 3] - along) / mobility[i], 0.0)
                more, reaction_n[c] = after - reaction_n[c], after
                displacement_m[i, 0] += mobility[i] * more * pushes[c, 1]
                displacement_m[i, 1] += mobility[i] * more * pushes[c, 2]
            for c in range(p):
                i, j = int(pairs[c, 0]), int(pairs[c, 1])
                both = mobility[i] + mobility[j]
                if both <= 0.0:
                    continue
                along_x = displacement_m[j, 0] - displacement_m[i, 0]
                along_y = displacement_m[j, 1] - displacement_m[i, 1]
                along = along_x * pairs[c, 2] + along_y * pairs[c, 3]
                after = max(tension[c] - (along + pairs[c, 4]) / both, 0.0)
                more, tension[c] = after - tension[c], after
                displacement_m[i, 0] -= mobility[i] * more * pairs[c, 2]
                displacement_m[i, 1] -= mobility[i] * more * pairs[c, 3]
                displacement_m[j, 0] += mobility[j] * more * pairs[c, 2]
                displacement_m[j, 1] += mobility[j] * more * pairs[c, 3]
        for i in range(n):
            way = distance_m(displacement_m[i, 0], displacement_m[i, 1])
            mobility[i] = max(way, _STANDS * step_m) / force_n[i]

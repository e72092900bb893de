"""The tip among particles: it rides over a particle that holds, and pushes one that yields.

The contact is quasi-static and rigid-plastic, because the weight of a sphere of 250 nm is 6e-8 of its friction. The tip
has the lateral stiffness k_lat; it hangs on a cantilever k whose apex would be at z_b without a force. A particle at
rest is pressed with F = k_lat (d(z) - r), where r is the distance to the axis of the stage, and it carries
F tan(theta - phi) upwards: the apex stays on the substrate as long as the load suffices, and then climbs the flank. If
F exceeds the hold of the particle it yields: F is then the kinetic friction, and the centre moves along the line to the
axis until it is d(z) - F / k_lat away. A straight push from phi_0 therefore loses it after d ln cot(phi_0 / 2).

A tick is divided into steps of at most 0.02 d, which give that distance within 0.5 %.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics import always_compiled, compiled
from telenano_lab.assembly.particles.adhered_sphere import area_ratio
from telenano_lab.assembly.particles.cluster import give_way
from telenano_lab.assembly.particles.tip_shape import (
    Spring,
    TipShape,
    climb,
    distance_m,
    join_height_m,
    ride_height_m,
    touch_distance_m,
)

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

# Columns of `fixed`, one row per particle: radius [m], static and kinetic hold, pull-off force [N].
RADIUS, STATIC, KINETIC, PULL_OFF = range(4)
# Columns of `moving`, one row per particle: place [m] and time of rest [s].
X, Y, RESTED = range(3)

# Columns of a push. The first are those of `give_way`: number in the cluster, direction, overlap [m]. The others are
# the particle, its distance [m], height of the apex [m] and force [N] if it held, and its height when pushing [m].
MEMBER, ALONG_X, ALONG_Y, OVERLAP, PARTICLE, DISTANCE, HELD_APEX, HELD_FORCE, APEX = range(9)
_COLUMNS = 9

LARGEST_STEP = 0.02
# Particles further apart than this number of overlaps cannot meet in a step.
_REACH_OF_STEP = 4.0
_BISECTIONS = 60
# A tip within this distance of a centre pushes in no direction.
_TOUCHES_M = 1e-13


class Contact(NamedTuple):
    """The contact of the tip at the end of a tick.

    apex_m: height at which particles hold it up [m], 0 if none does; lift_n: their upward force [N] on a tip that they
    do not hold up alone; push_x_n, push_y_n: their lateral force on the tip [N]; touched: number of touched particles;
    moved: number of moved ones.
    """

    apex_m: float
    lift_n: float
    push_x_n: float
    push_y_n: float
    touched: int
    moved: int


@compiled
def height_m(tip: TipShape, fixed: Array, moving: Array, x_m: float, y_m: float) -> float:
    """Return the height at which particles hold up an apex at a place [m], 0 if none does."""
    highest = 0.0
    for i in range(moving.shape[0]):
        r = distance_m(moving[i, X] - x_m, moving[i, Y] - y_m)
        highest = max(highest, ride_height_m(tip, fixed[i, RADIUS], r))
    return highest


@compiled
def _pressed(
    tip: TipShape, spring: Spring, radius_m: float, r: float, held_up_m: float, free_m: float
) -> tuple[float, float]:
    """Return the height of the apex [m] and the lateral force [N] against a particle that holds.

    Args:
        tip: The shape of the tip.
        spring: The stiffness of the tip.
        radius_m: The radius of the particle [m].
        r: The distance between the particle's centre and the axis of the stage [m].
        held_up_m: Height of the apex without the particle [m].
        free_m: Height of the apex without any force [m].
    """
    k, lateral, mu = spring.normal_n_per_m, spring.lateral_n_per_m, spring.friction
    force = lateral * (touch_distance_m(tip, radius_m, held_up_m) - r)
    slope = climb(tip, radius_m, held_up_m, mu)
    if k * (held_up_m - free_m) >= force * slope:
        return held_up_m, force
    # On the cone the slope is constant, so the balance of forces is linear in z.
    joined = join_height_m(tip, radius_m)
    if held_up_m < joined:
        most = lateral * (touch_distance_m(tip, radius_m, 0.0) - r)
        z = (k * free_m + slope * most) / (k + slope * lateral * tip.tan_cone)
        if z <= joined:
            return max(z, held_up_m), max(most - lateral * tip.tan_cone * z, 0.0)
    low, high = max(held_up_m, joined), max(ride_height_m(tip, radius_m, r), held_up_m, joined)
    for _ in range(_BISECTIONS):
        z = 0.5 * (low + high)
        if z <= low or z >= high:
            break
        force = lateral * (touch_distance_m(tip, radius_m, z) - r)
        if k * (z - free_m) >= force * climb(tip, radius_m, z, mu):
            high = z
        else:
            low = z
    return high, max(lateral * (touch_distance_m(tip, radius_m, high) - r), 0.0)


@compiled
def _yielding_m(
    tip: TipShape, spring: Spring, radius_m: float, force_n: float, held_up_m: float, free_m: float, most_m: float
) -> float:
    """Return the height of an apex [m] that pushes with a lateral force [N], at most most_m, that against a hold."""
    k, mu = spring.normal_n_per_m, spring.friction
    slope = climb(tip, radius_m, held_up_m, mu)
    if k * (held_up_m - free_m) >= force_n * slope:
        return held_up_m
    joined = join_height_m(tip, radius_m)
    if held_up_m < joined and free_m + force_n * slope / k <= joined:
        return min(max(free_m + force_n * slope / k, held_up_m), most_m)
    low, high = max(held_up_m, min(joined, most_m)), most_m
    for _ in range(_BISECTIONS):
        z = 0.5 * (low + high)
        if z <= low or z >= high:
            break
        if k * (z - free_m) >= force_n * climb(tip, radius_m, z, mu):
            high = z
        else:
            low = z
    return high


@compiled
def _hold_n(spring: Spring, fixed: Array, moving: Array, i: int, load_n: float) -> float:
    """Return the lateral force [N] at which a particle under a load [N] starts to move."""
    hold = fixed[i, STATIC] if moving[i, RESTED] >= spring.rest_s else fixed[i, KINETIC]
    return hold * area_ratio(load_n, fixed[i, PULL_OFF]) if spring.loaded_area else float(hold)


@compiled
def _kinetic_n(spring: Spring, fixed: Array, i: int, slope: float) -> float:
    """Return the kinetic friction [N] of a particle if a push of 1 N loads it by `slope` newtons."""
    force = fixed[i, KINETIC]
    if not spring.loaded_area:
        return float(force)
    for _ in range(20):
        force = fixed[i, KINETIC] * area_ratio(force * slope, fixed[i, PULL_OFF])
    return float(force)


@compiled
def _gap_m(fixed: Array, moving: Array, i: int, j: int) -> float:
    """Return the horizontal gap between two spheres that lie on a plane [m]."""
    between = distance_m(moving[j, X] - moving[i, X], moving[j, Y] - moving[i, Y])
    return between - 2.0 * math.sqrt(fixed[i, RADIUS] * fixed[j, RADIUS])


@compiled
def _cluster(fixed: Array, moving: Array, pushes: Array) -> Array:
    """Return the numbers of the pushed particles, in order, followed by those that they may push in turn."""
    n, count, looked, way_m = moving.shape[0], pushes.shape[0], 0, 0.0
    members, is_looked_at = np.empty(n), np.zeros(n)
    for c in range(count):
        members[c] = pushes[c, PARTICLE]
        is_looked_at[int(pushes[c, PARTICLE])] = 1.0
        way_m = max(way_m, pushes[c, OVERLAP])
    while looked < count:
        i = int(members[looked])
        looked += 1
        for j in range(n):
            if is_looked_at[j] == 0.0 and _gap_m(fixed, moving, i, j) <= _REACH_OF_STEP * way_m:
                members[count] = j
                is_looked_at[j] = 1.0
                count += 1
    return members[:count]


@compiled
def _gives_way(
    spring: Spring, fixed: Array, moving: Array, members: Array, pushes: Array, kinetic: bool
) -> tuple[Array, Array]:
    """Return the displacements of the members of a cluster [m], shape (n, 2), and the forces of the tip [N].

    kinetic: whether all members resist with kinetic friction, rather than with their hold.
    """
    count_found, count = members.shape[0], pushes.shape[0]
    force, reaction, displacement = np.empty(count_found), np.zeros(count), np.zeros((count_found, 2))
    pairs = np.empty((count_found * (count_found - 1) // 2, 5))
    p, way_m = 0, 0.0
    for c in range(count):
        way_m = max(way_m, pushes[c, OVERLAP])
    for a in range(count_found):
        i = int(members[a])
        force[a] = fixed[i, KINETIC] if kinetic else _hold_n(spring, fixed, moving, i, 0.0)
        for b in range(a + 1, count_found):
            j = int(members[b])
            gap = _gap_m(fixed, moving, i, j)
            if gap <= _REACH_OF_STEP * way_m:
                x, y = moving[j, X] - moving[i, X], moving[j, Y] - moving[i, Y]
                between = distance_m(x, y)
                pairs[p, 0], pairs[p, 1], pairs[p, 2], pairs[p, 3], pairs[p, 4] = a, b, x / between, y / between, gap
                p += 1
    give_way(force, pairs[:p], pushes, displacement, reaction)
    return displacement, reaction


@compiled
def _push_with(
    tip: TipShape, spring: Spring, fixed: Array, row: Array, force_n: float, held_up_m: float, free_m: float
) -> None:
    """Write the apex height and the overlap of a push with force_n [N] into its row."""
    radius = fixed[int(row[PARTICLE]), RADIUS]
    z = _yielding_m(tip, spring, radius, force_n, held_up_m, free_m, row[HELD_APEX])
    row[APEX] = z
    row[OVERLAP] = max(touch_distance_m(tip, radius, z) - force_n / spring.lateral_n_per_m - row[DISTANCE], 0.0)


@compiled
def _touched(
    tip: TipShape,
    spring: Spring,
    fixed: Array,
    moving: Array,
    near: Numbers,
    place: tuple[float, float],
    heights: tuple[float, float],
) -> tuple[Array, int, Contact]:
    """Return the pushes against yielding particles, their number, and the contact with those that hold."""
    held_up, free = heights
    pushes = np.empty((near.shape[0], _COLUMNS))
    p, touched = 0, 0
    apex, lift, push_x, push_y = held_up, 0.0, 0.0, 0.0
    for i in near:
        radius, x, y = fixed[i, RADIUS], moving[i, X] - place[0], moving[i, Y] - place[1]
        r = distance_m(x, y)
        if not _TOUCHES_M < r < touch_distance_m(tip, radius, held_up):
            continue
        touched += 1
        z, force = _pressed(tip, spring, radius, r, held_up, free)
        slope = climb(tip, radius, z, spring.friction)
        if force > _hold_n(spring, fixed, moving, i, force * slope):
            row = pushes[p]
            row[MEMBER], row[ALONG_X], row[ALONG_Y] = p, x / r, y / r
            row[PARTICLE], row[DISTANCE], row[HELD_APEX], row[HELD_FORCE] = i, r, z, force
            _push_with(tip, spring, fixed, row, _kinetic_n(spring, fixed, i, slope), held_up, free)
            p += 1
        else:
            push_x -= force * x / r
            push_y -= force * y / r
            lift += force * slope
            apex = max(apex, z)
    return pushes, p, Contact(apex, lift, push_x, push_y, touched, 0)


@compiled
def _small_step(
    tip: TipShape,
    spring: Spring,
    fixed: Array,
    moving: Array,
    near: Numbers,
    place: tuple[float, float],
    heights: tuple[float, float],
) -> Contact:
    """Bring the stage to a place [m], move the yielding particles in `moving`, and return the contact there."""
    every, p, holding = _touched(tip, spring, fixed, moving, near, place, heights)
    if p == 0:
        return holding
    pushes = every[:p]
    members = _cluster(fixed, moving, pushes)
    forces, displacement = pushes[:, HELD_FORCE].copy(), np.zeros((members.shape[0], 2))
    yields = True
    if members.shape[0] == 1:
        row = pushes[0]
        forces[0] = _kinetic_n(
            spring, fixed, int(row[PARTICLE]), climb(tip, fixed[int(row[PARTICLE]), RADIUS], row[APEX], spring.friction)
        )
        displacement[0, 0], displacement[0, 1] = row[OVERLAP] * row[ALONG_X], row[OVERLAP] * row[ALONG_Y]
    else:
        # A cluster yields if its hold is less than the tip's force against particles at rest.
        resists = _gives_way(spring, fixed, moving, members, pushes, False)[1]
        for c in range(p):
            yields = yields and pushes[c, HELD_FORCE] > resists[c]
        if yields:
            moved_with = _gives_way(spring, fixed, moving, members, pushes, True)[1]
            for c in range(p):
                _push_with(tip, spring, fixed, pushes[c], moved_with[c], heights[0], heights[1])
            displacement, forces = _gives_way(spring, fixed, moving, members, pushes, True)
    apex, lift, push_x, push_y, moved = holding.apex_m, holding.lift_n, holding.push_x_n, holding.push_y_n, 0
    for c in range(p):
        z = pushes[c, APEX] if yields else pushes[c, HELD_APEX]
        push_x -= forces[c] * pushes[c, ALONG_X]
        push_y -= forces[c] * pushes[c, ALONG_Y]
        lift += forces[c] * climb(tip, fixed[int(pushes[c, PARTICLE]), RADIUS], z, spring.friction)
        apex = max(apex, z)
    for a in range(members.shape[0]):
        i = int(members[a])
        if yields and (displacement[a, 0] != 0.0 or displacement[a, 1] != 0.0):
            moving[i, X] += displacement[a, 0]
            moving[i, Y] += displacement[a, 1]
            moving[i, RESTED] = 0.0
            moved += 1
    return Contact(apex, lift, push_x, push_y, holding.touched, moved)


@always_compiled
def push_step(
    tip: TipShape,
    spring: Spring,
    fixed: Array,
    moving: Array,
    way: tuple[float, float, float, float],
    heights: tuple[float, float],
    dt: float,
) -> tuple[Array, Contact]:
    """Return the particles after the stage has moved for dt, and the contact of the tip at the end.

    Args:
        tip: The shape of the tip.
        spring: The stiffness of the tip, and options of the contact.
        fixed: Constants of each particle, shape (n, 4).
        moving: State of each particle, shape (n, 3); not modified, and returned as it is if no particle is near or
            moving.
        way: Start and end of the motion of the stage, x0, y0, x1, y1 [m].
        heights: Height of the apex on substrate or spring without particles [m], and its height without any force [m].
        dt: The time of the step [s].
    """
    n = moving.shape[0]
    nearest, count, stirs = math.inf, 0, False
    length = distance_m(way[2] - way[0], way[3] - way[1])
    middle_x, middle_y = 0.5 * (way[0] + way[2]), 0.5 * (way[1] + way[3])
    near = np.empty(n, np.int64)
    for i in range(n):
        reach = touch_distance_m(tip, fixed[i, RADIUS], 0.0)
        stirs = stirs or moving[i, RESTED] < spring.rest_s
        # A pushed particle may push another one into the way, so those a little further away count as well.
        if distance_m(moving[i, X] - middle_x, moving[i, Y] - middle_y) <= reach + 1.5 * length:
            near[count] = i
            count += 1
            nearest = min(nearest, reach)
    if count == 0 and not stirs:
        return moving, Contact(0.0, 0.0, 0.0, 0.0, 0, 0)
    after = moving.copy()
    for i in range(n):
        after[i, RESTED] = min(after[i, RESTED] + dt, max(spring.rest_s, after[i, RESTED]))
    contact = Contact(0.0, 0.0, 0.0, 0.0, 0, 0)
    moved = 0
    steps = max(math.ceil(length / (LARGEST_STEP * nearest)), 1) if count > 0 else 0
    for s in range(1, steps + 1):
        share = s / steps
        x, y = way[0] + share * (way[2] - way[0]), way[1] + share * (way[3] - way[1])
        contact = _small_step(tip, spring, fixed, after, near[:count], (x, y), heights)
        moved += contact.moved
    return after, Contact(contact.apex_m, contact.lift_n, contact.push_x_n, contact.push_y_n, contact.touched, moved)


def packed(tip: TipShape, spring: Spring) -> Array:
    """Return tip and spring as one array for `tick`: passing their fields would take longer than a step."""
    return np.array((*tip, *spring), np.float64)


@always_compiled
def tick(
    model: Array,
    fixed: Array,
    moving: Array,
    x0_m: float,
    y0_m: float,
    x1_m: float,
    y1_m: float,
    held_up_m: float,
    free_m: float,
    driven: bool,
    dt: float,
) -> tuple[Array, Contact]:
    """Return the result of `push_step`; where the tip touches nothing, apex_m is the height at which it would touch.

    Args:
        model: Tip and spring (`packed`).
        fixed: Constants of each particle, shape (n, 4).
        moving: State of each particle, shape (n, 3); not modified.
        x0_m: Start of the stage, x [m].
        y0_m: Start of the stage, y [m].
        x1_m: End of the stage, x [m].
        y1_m: End of the stage, y [m].
        held_up_m: Height of the apex on substrate or spring without particles [m].
        free_m: Height of the apex without any force [m].
        driven: Whether the tip vibrates, and so passes no lateral force on.
        dt: The time of the step [s].
    """
    tip = TipShape(model[0], model[1], model[2], model[3])
    spring = Spring(model[4], model[5], model[6], model[7] != 0.0, model[8])
    # A vibrating tip is treated as one above all particles, which touches none.
    heights = (math.inf, math.inf) if driven else (held_up_m, free_m)
    way = (x1_m, y1_m, x1_m, y1_m) if driven else (x0_m, y0_m, x1_m, y1_m)
    after, met = push_step(tip, spring, fixed, moving, way, heights, dt)
    if met.touched > 0:
        return after, met
    return after, Contact(height_m(tip, fixed, after, x1_m, y1_m), 0.0, 0.0, 0.0, 0, met.moved)

"""Plan an assembly: assign particles to targets, order the pushes, and find their paths.

Targets are assigned so that the sum of the squared distances is least. A path leads around the other particles, each
enlarged by the room that the pushed one and the tip need, along the corners of the polygons around them; it is the
shortest path in the graph of all corners that see each other. A particle whose target is still occupied, or whose path
is blocked by another that has yet to move, waits; if all wait for each other, one goes to a parking place first.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from telenano.wire import ConfigError

Array = npt.NDArray[np.float64]
Point = tuple[float, float]

# Number of corners of the polygon around an obstacle.
_CORNERS = 12


class Task(NamedTuple):
    """A push: number of the particle, and its path from start to end with the corners between [m].

    target: the number of the target, -1 for a parking place.
    """

    particle: int
    way: tuple[Point, ...]
    target: int

    @property
    def length_m(self) -> float:
        return sum(math.dist(a, b) for a, b in pairwise(self.way))


class UnreachableError(ConfigError):
    """A target without a free path, or that cannot be used; the message names it."""


def assigned(places: npt.ArrayLike, targets: npt.ArrayLike) -> list[int]:
    """Return the target of each particle, -1 for none, so that the sum of the squared distances is least.

    Args:
        places: Places of the particles, shape (n, 2) [m].
        targets: Targets, shape (m, 2) [m], at most n.

    Raises:
        UnreachableError: There are more targets than particles.
    """
    at, to = np.asarray(places, np.float64).reshape(-1, 2), np.asarray(targets, np.float64).reshape(-1, 2)
    if len(to) > len(at):
        raise UnreachableError(f"the pattern has {len(to)} places, and {len(at)} particles were found")
    ways = np.sum((at[:, None, :] - to[None, :, :]) ** 2, axis=2)
    result = [-1] * len(at)
    for particle, target in zip(*linear_sum_assignment(ways), strict=True):
        result[int(particle)] = int(target)
    return result


def require_room(targets: Sequence[Point], clearance_m: float) -> None:
    """Raise UnreachableError, naming the first pair, if targets [m] are nearer to each other than clearance_m [m]."""
    for i, one in enumerate(targets):
        for j in range(i):
            if math.dist(one, targets[j]) < clearance_m:
                raise UnreachableError(
                    f"targets {j} and {i} are {math.dist(one, targets[j]):.3g} m apart: a particle that is pushed"
                    f" between them needs {clearance_m:.3g} m"
                )


def way_around(start: Point, goal: Point, obstacles: list[Point], clearance_m: float) -> tuple[Point, ...] | None:
    """Return the shortest path from start to goal that keeps clearance_m [m] from each obstacle; None if there is none.

    Obstacles within that distance of the start are ignored.
    """
    kept = [one for one in obstacles if math.dist(one, start) > clearance_m * (1.0 + 1e-9)]
    if any(math.dist(one, goal) < clearance_m * (1.0 - 1e-9) for one in obstacles):
        return None
    if _is_clear(start, goal, kept, clearance_m):
        return (start, goal)
    outside = clearance_m / math.cos(math.pi / _CORNERS) * (1.0 + 1e-6)
    nodes = [start, goal]
    for x, y in kept:
        for corner in range(_CORNERS):
            angle = 2.0 * math.pi * (corner + 0.5) / _CORNERS
            node = (x + outside * math.cos(angle), y + outside * math.sin(angle))
            if all(math.dist(node, other) >= clearance_m for other in kept):
                nodes.append(node)
    graph = np.zeros((len(nodes), len(nodes)))
    for i, a in enumerate(nodes):
        for j in range(i + 1, len(nodes)):
            if _is_clear(a, nodes[j], kept, clearance_m):
                graph[i, j] = math.dist(a, nodes[j])
    lengths, before = dijkstra(csr_matrix(graph), directed=False, indices=0, return_predecessors=True)
    if not math.isfinite(lengths[1]):
        return None
    way, at = [goal], 1
    while at != 0:
        at = int(before[at])
        way.append(nodes[at])
    return tuple(reversed(way))


def _is_clear(a: Point, b: Point, obstacles: list[Point], clearance_m: float) -> bool:
    """Return whether a straight path keeps its distance from all obstacles."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    squared = dx * dx + dy * dy
    for x, y in obstacles:
        share = 0.0 if squared == 0.0 else min(max(((x - a[0]) * dx + (y - a[1]) * dy) / squared, 0.0), 1.0)
        if math.dist((x, y), (a[0] + share * dx, a[1] + share * dy)) < clearance_m * (1.0 - 1e-9):
            return False
    return True


def planned(
    places: npt.ArrayLike,
    targets: npt.ArrayLike,
    clearance_m: float,
    done_m: float,
    half_m: float,
    fixed: Sequence[Point] = (),
) -> list[Task]:
    """Return the pushes that bring particles to all targets, in their order.

    Args:
        places: Places of the particles, shape (n, 2) [m].
        targets: Targets, shape (m, 2) [m].
        clearance_m: Distance of the centre of a pushed particle from those of others [m].
        done_m: A particle nearer to its target than this stays [m].
        half_m: Half of the side of the square within which a parking place may lie [m].
        fixed: Places of fixed obstacles [m], such as the steps of a sample.

    Raises:
        UnreachableError: A target lies too near to another, to a particle that stays or to a fixed obstacle, or no way
            leads to it.
    """
    stands = list(fixed)
    at = [(float(x), float(y)) for x, y in np.asarray(places, np.float64).reshape(-1, 2)]
    to = [(float(x), float(y)) for x, y in np.asarray(targets, np.float64).reshape(-1, 2)]
    require_room(to, clearance_m)
    for i, one in enumerate(to):
        near = min((math.dist(one, other) for other in stands), default=math.inf)
        if near < clearance_m:
            raise UnreachableError(
                f"target {i} is {near:.3g} m from something fixed on the sample: a particle that is pushed there needs"
                f" {clearance_m:.3g} m"
            )
    goal_of = assigned(at, to)
    waiting = [i for i, target in enumerate(goal_of) if target >= 0 and math.dist(at[i], to[target]) > done_m]
    tasks: list[Task] = []
    parked: set[int] = set()
    while waiting:
        found = [_task(i, at, stands, to[goal_of[i]], goal_of[i], clearance_m) for i in waiting]
        ready = [(task.length_m, task) for task in found if task]
        if ready:
            task = min(ready)[1]
            waiting.remove(task.particle)
        else:
            task = _parking(waiting, parked, at, stands, to, clearance_m, half_m)
            parked.add(task.particle)
        tasks.append(task)
        at[task.particle] = task.way[-1]
    return tasks


def _task(
    particle: int, at: list[Point], stands: list[Point], goal: Point, target: int, clearance_m: float
) -> Task | None:
    others = [place for j, place in enumerate(at) if j != particle] + stands
    way = way_around(at[particle], goal, others, clearance_m)
    return None if way is None else Task(particle, way, target)


def _parking(
    waiting: list[int],
    parked: set[int],
    at: list[Point],
    stands: list[Point],
    to: list[Point],
    clearance_m: float,
    half_m: float,
) -> Task:
    """Return a push of one of the waiting particles to the nearest place that blocks no target or particle."""
    raster = np.arange(-half_m, half_m + 0.5 * clearance_m, 0.5 * clearance_m).tolist()
    for particle in (i for i in waiting if i not in parked):
        taken = [place for j, place in enumerate(at) if j != particle] + to + stands
        free = [(x, y) for x in raster for y in raster if all(math.dist((x, y), one) >= clearance_m for one in taken)]
        for place in sorted(free, key=lambda one: math.dist(one, at[particle])):
            if task := _task(particle, at, stands, place, -1, clearance_m):
                return task
    raise UnreachableError(
        "no free path leads to the targets of particles " + ", ".join(str(i) for i in waiting) + ": others block it"
    )

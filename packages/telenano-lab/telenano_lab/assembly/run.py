"""Carry out an assembly: image, find, plan, push and look again, until each particle is in place.

The assembler uses only the results of images and pushes, never the truth. Places are those of the sample when the
assembly began; the drift of the sample under the stage is estimated from particles seen twice without a push between.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from telenano.devices import VirtualInstrument
from telenano.extend.programs import Wanted
from telenano.sections import AfmConfig
from telenano.wire import Scalar
from telenano_lab.assembly.drift import Drift, drift_at, moved, offset_at, unknown
from telenano_lab.assembly.find import FoundParticle, find_particles, fixed_places
from telenano_lab.assembly.particle_bench import particles_of
from telenano_lab.assembly.particles.settings import ParticlesConfig
from telenano_lab.assembly.particles.tip_shape import tip_shape, touch_distance_m
from telenano_lab.assembly.plan import Point, Task, UnreachableError, planned, require_room
from telenano_lab.assembly.recording import AssemblyRecorder

Array = npt.NDArray[np.float64]

# A particle has arrived within this share of its diameter.
DONE_SHARE = 0.1
# An image of one particle reaches this multiple of d to each side of it.
_LOOK_SIDE = 2.0
# The number of lines of an image of one particle.
_LOOK_LINES = 14
# The number of pixels of a line of it.
_LOOK_PIXELS = 28
# The edges of that image keep this multiple of d from other particles.
_EDGE = 1.05
# They keep at least this multiple of d from the particle itself, even if another one is nearer.
_LEAST_SIDE = 1.1
# Width of a pixel of an image of all particles, as a share of their known radius.
_PIXEL_SHARE = 0.5
# Distance of the lines of that image, as a share of the radius.
_LINE_SHARE = 0.8
# Least standard error of a place in an image, whatever its noise [m].
_LEAST_ERROR_M = 1e-9
_MOST_ROUNDS = 6
# An object whose radius differs by more than this share is not one of the particles.
_OTHER_RADIUS = 0.3
# The tip approaches the surface at this speed.
_APPROACH_M_PER_S = 5e-6
# The tip pushes with this normal force.
_TOUCH_N = 4e-9
# The gain of the feedback of scans.
_GAIN_PER_S = 1200.0


class Look(NamedTuple):
    """An image [m] with its middle [m], its sides [m], and the times at which it began and ended [s]."""

    height_m: Array
    middle: Point
    sides_m: tuple[float, float]
    began_s: float
    ended_s: float

    @property
    def step_m(self) -> tuple[float, float]:
        """Return width and depth of a pixel [m]."""
        rows, columns = self.height_m.shape
        return self.sides_m[0] / columns, self.sides_m[1] / rows


class PushReport(NamedTuple):
    """The result of a push: reason of its end, whether a particle was met, and its believed place on the stage [m]."""

    why: str
    in_contact: bool
    believed: Point


class Bench(Protocol):
    """An instrument that takes images and pushes: a rig, or one in simulated time."""

    @property
    def time_s(self) -> float:
        """Return the time of the instrument [s]."""

    def image(self, middle: Point, sides_m: tuple[float, float], pixels: int, lines: int) -> Look:
        """Take an image."""

    def push(self, start: Point, goal: Point, radius_m: float) -> PushReport:
        """Push a particle from its believed place to another, both on the stage [m]."""


class TargetPlacement(NamedTuple):
    """A target, the believed place of the nearest particle, their distance [m], and its number of pushes."""

    target: Point
    believed: Point
    error_m: float
    pushes: int


class Assembly(NamedTuple):
    """The outcome: a row per target, the duration [s], counts of pushes, looks and losses, the drift, the images."""

    placed: tuple[TargetPlacement, ...]
    duration_s: float
    pushes: int
    looks: int
    losses: int
    drift: Drift
    before: Look
    after: Look


class _Known(NamedTuple):
    """A particle: place on the stage [m], radius [m], time at which it was seen [s], and number of pushes."""

    x_m: float
    y_m: float
    radius_m: float
    seen_s: float
    pushes: int = 0


class ProgramBench(ABC):
    """A bench whose images and pushes are programs of an instrument.

    Args:
        config: The known properties of the instrument.
        setpoint_n: Force of an image in contact [N], too small to move a particle.
        scan_m_per_s: Speed of its lines [m/s]. On a flank of 75 degrees the force is higher by k tan(75 deg) v (T + 1 /
            gain), T the period of the instrument: 1.4 nN for 2 um/s on the usual bench.
    """

    def __init__(self, config: AfmConfig, setpoint_n: float = 1.5e-9, scan_m_per_s: float = 2e-6) -> None:
        particles = particles_of(config) or ParticlesConfig()
        self._scan_m_per_s = scan_m_per_s
        self._scan: dict[str, Scalar] = {
            "program": "scan",
            "scan.mode": "contact",
            "scan.setpoint_n": setpoint_n,
            "scan.gain_per_s": _GAIN_PER_S,
            "scan.approach_m_per_s": _APPROACH_M_PER_S,
            "scan.settle_s": 0.05,
        }
        self._push: dict[str, Scalar] = {
            "program": "push",
            "push.approach_m_per_s": _APPROACH_M_PER_S,
            "push.setpoint_n": _TOUCH_N,
            "push.tip_radius_m": config.tip_sample.tip_radius_m,
            "push.cone_deg": particles.cone_deg,
        }

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Return the time of the instrument [s]."""

    @abstractmethod
    def lines(self, keys: dict[str, Scalar]) -> Iterator[tuple[int, Array]]:
        """Run the program of an image, and yield the number and heights [m] of each line, both ways."""

    @abstractmethod
    def values(self, keys: dict[str, Scalar]) -> Mapping[str, Scalar]:
        """Run the program of a push and return the values of its last report."""

    def image(self, middle: Point, sides_m: tuple[float, float], pixels: int, lines: int) -> Look:
        began_s, rows = self.time_s, np.full((lines, pixels), np.inf)
        keys = self._scan | {
            "scan.x_m": middle[0],
            "scan.y_m": middle[1],
            "scan.width_m": sides_m[0],
            "scan.depth_m": sides_m[1],
            "scan.pixels": pixels,
            "scan.lines": lines,
            "scan.dwell_s": max(sides_m[0] / pixels / self._scan_m_per_s, 2e-3),
        }
        for number, height_m in self.lines(keys):
            # A tip that descends behind a particle lags and one that climbs does not: the lower trace is right.
            rows[number] = np.minimum(rows[number], height_m)
        return Look(np.where(np.isfinite(rows), rows, np.nan), middle, sides_m, began_s, self.time_s)

    def push(self, start: Point, goal: Point, radius_m: float) -> PushReport:
        ends = {"push.x0_m": start[0], "push.y0_m": start[1], "push.x1_m": goal[0], "push.y1_m": goal[1]}
        values = self.values(self._push | ends | {"push.radius_m": radius_m})
        believed = (float(values["believed_x_m"]), float(values["believed_y_m"]))
        return PushReport(str(values["why"]), bool(values["in_contact"]), believed)


class VirtualBench(ProgramBench):
    """A bench in simulated time.

    Args:
        config: The instrument with its particles.
        folder: Folder of its recording; None for no recording.
    """

    def __init__(self, config: AfmConfig, folder: Path | None = None) -> None:
        # No step of simulated time is late, so the tip may go faster than on a rig.
        super().__init__(config, scan_m_per_s=5e-6)
        self.instrument = VirtualInstrument(config)
        self.recorder = None if folder is None else AssemblyRecorder(folder, self.instrument)

    @property
    def time_s(self) -> float:
        return self.instrument.time_s

    def truth(self) -> list[Point]:
        """Return the true places of the particles on the sample [m], which no planner may use."""
        return [(x, y) for x, y in self.instrument.truths["particles"].places_m.tolist()]

    def lines(self, keys: dict[str, Scalar]) -> Iterator[tuple[int, Array]]:
        for wanted in self._steps(keys):
            if wanted.line is not None:
                yield wanted.line.line, wanted.line.height_m

    def _steps(self, keys: dict[str, Scalar]) -> Iterator[Wanted[Any]]:
        """Run a program and record it."""
        for step in self.instrument.run(keys):
            if self.recorder is not None:
                self.recorder.step()
            yield step.wanted
        if self.recorder is not None:
            self.recorder.ended()

    def values(self, keys: dict[str, Scalar]) -> Mapping[str, Scalar]:
        for _ in self._steps(keys):
            pass
        outcome = self.instrument.outcome
        return {} if outcome is None or outcome.values is None else outcome.values


def look_sides_m(place: Point, others: list[Point], reach_m: float) -> tuple[float, float]:
    """Return the sides of an image of a particle [m] whose edges avoid other particles, as far as there is room.

    At an edge the tip steps from line to line, and would push a particle on whose flank it is.

    Args:
        place: The particle [m].
        others: The places of the other particles [m].
        reach_m: Radius of the image of a particle [m].
    """
    halves = [_LOOK_SIDE * reach_m, _LOOK_SIDE * reach_m]
    for x, y in others:
        away = abs(x - place[0]), abs(y - place[1])
        axis = 0 if away[0] >= away[1] else 1
        if away[1 - axis] < halves[1 - axis] + _EDGE * reach_m:
            halves[axis] = max(min(halves[axis], away[axis] - _EDGE * reach_m), _LEAST_SIDE * reach_m)
    return 2.0 * halves[0], 2.0 * halves[1]


def _room_m(radius_m: float, reach_m: float) -> float:
    """Return the distance [m] of a pushed particle's centre from others that leaves room for the tip between them."""
    return 2.0 * radius_m + 0.5 * reach_m


class Assembler:
    """Carries out an assembly on a bench.

    Args:
        bench: The instrument.
        config: The known properties of the tip and of the kind of particle on the sample.
        targets: Target places on the sample [m].
        sides_m: Sides of the region that is imaged [m].
        report: Called at each step with a sentence and the number of occupied targets.

    Raises:
        UnreachableError: A target lies outside the region or too near to its edge to be imaged whole, or too near to
            another.
    """

    def __init__(
        self,
        bench: Bench,
        config: AfmConfig,
        targets: list[Point],
        sides_m: tuple[float, float],
        report: Callable[[str, int], None] = lambda text, done: None,
    ) -> None:
        particles = particles_of(config) or ParticlesConfig()
        self._nominal_m = particles.kind.radius_m
        self._bench, self._targets, self._sides, self._report = bench, targets, sides_m, report
        self._tip = tip_shape(config.tip_sample.tip_radius_m, math.radians(particles.cone_deg))
        reach_m = touch_distance_m(self._tip, self._nominal_m, 0.0)
        for number, (x, y) in enumerate(targets):
            if abs(x) > 0.5 * sides_m[0] - reach_m or abs(y) > 0.5 * sides_m[1] - reach_m:
                raise UnreachableError(
                    f"target {number} at {x:g}, {y:g} m must lie {reach_m:.3g} m or more within the sample of"
                    f" {sides_m[0]:g} x {sides_m[1]:g} m, whose middle is 0, 0"
                )
        require_room(targets, _room_m(self._nominal_m, reach_m))
        self._drift = Drift(bench.time_s, unknown(), unknown())
        self._known: list[_Known] = []
        self._fixed: list[Point] = []
        self._pushes = self._looks = self._losses = 0

    def run(self) -> Assembly:
        """Assemble the particles and return the outcome.

        Raises:
            UnreachableError: There are too few particles, or no path leads to a target.
        """
        before = self._whole()
        self._tell(f"{len(self._known)} particles were found")
        after = before
        for _ in range(_MOST_ROUNDS):
            for task in self._plan():
                if not self._carry_out(task):
                    break
            after = self._whole()
            # A push may have moved another particle than the one that was looked at.
            if not self._plan():
                break
        return self._outcome(before, after)

    def _tell(self, text: str) -> None:
        places = [(self._place(one), DONE_SHARE * 2.0 * one.radius_m) for one in self._known]
        done = sum(any(math.dist(place, target) <= near for place, near in places) for target in self._targets)
        self._report(text, done)

    def _plan(self) -> list[Task]:
        radius = max((one.radius_m for one in self._known), default=0.0)
        reach = touch_distance_m(self._tip, radius, 0.0) if radius > 0.0 else 0.0
        half = 0.5 * min(self._sides) - 2.0 * reach
        places = [self._place(one) for one in self._known]
        return planned(places, self._targets, _room_m(radius, reach), DONE_SHARE * radius, half, self._fixed)

    def _carry_out(self, task: Task) -> bool:
        """Push a particle along its path; return whether the plan still holds."""
        if not self._look_at(task.particle):
            return self._lost()
        for corner in task.way[1:]:
            one = self._known[task.particle]
            if math.dist(self._place(one), corner) < 0.2 * DONE_SHARE * one.radius_m:
                continue
            state = self._bench.push(self._on_stage(self._place(one)), self._on_stage(corner), one.radius_m)
            self._pushes += 1
            self._tell(f"particle {task.particle}: {state.why}")
            believed = state.believed if state.in_contact else (one.x_m, one.y_m)
            self._known[task.particle] = one._replace(
                x_m=believed[0], y_m=believed[1], seen_s=self._bench.time_s, pushes=one.pushes + 1
            )
            if not self._look_at(task.particle, was_pushed=True):
                return self._lost()
            if math.dist(self._place(self._known[task.particle]), corner) > 0.5 * one.radius_m:
                self._losses += 1
                return False
        return True

    def _lost(self) -> bool:
        """Look for all particles again, because one is not at its believed place; return False (end of the plan)."""
        self._losses += 1
        self._whole()
        return False

    def _place(self, one: _Known) -> Point:
        """Return the place of a particle on the sample [m]."""
        x, y = offset_at(self._drift, one.seen_s)
        return one.x_m - x, one.y_m - y

    def _on_stage(self, place: Point) -> Point:
        """Return the place on the stage of a place on the sample, now [m]."""
        x, y = offset_at(self._drift, self._bench.time_s)
        return place[0] + x, place[1] + y

    def _seen(self, look: Look) -> list[tuple[FoundParticle, float]]:
        """Return the particles in an image with the times at which they were seen [s]; drop those of another size."""
        particles = find_particles(look.height_m, *look.step_m, self._tip, look.middle)
        spheres = [one for one in particles if abs(one.radius_m / self._nominal_m - 1.0) < _OTHER_RADIUS]
        return [(one, look.began_s + one.time * (look.ended_s - look.began_s)) for one in spheres]

    def _whole(self) -> Look:
        """Take an image of the whole region and update the places of all particles from it."""
        (width, depth), radius_m = self._sides, self._nominal_m
        pixels, lines = math.ceil(width / (_PIXEL_SHARE * radius_m)), math.ceil(depth / (_LINE_SHARE * radius_m))
        look = self._bench.image(self._on_stage((0.0, 0.0)), self._sides, max(pixels, 8), max(lines, 8))
        self._looks += 1
        before, self._known = self._known, []
        seen = self._seen(look)
        reach_m = touch_distance_m(self._tip, self._nominal_m, 0.0)
        drifted = self._on_stage((0.0, 0.0))
        self._fixed = [
            (x - drifted[0], y - drifted[1])
            for x, y in fixed_places(
                look.height_m, *look.step_m, [particle for particle, _ in seen], reach_m, look.middle
            )
        ]
        for particle, time_s in seen:
            one = _Known(particle.x_m, particle.y_m, particle.radius_m, time_s)
            near = [old for old in before if math.dist(self._place(old), self._place(one)) < one.radius_m]
            self._known.append(one._replace(pushes=near[0].pushes if near else 0))
        return look

    def _look_at(self, particle: int, *, was_pushed: bool = False) -> bool:
        """Image a particle at its believed place; return whether it is there. Without a push, update the drift."""
        one = self._known[particle]
        place, others = self._place(one), [self._place(other) for other in self._known if other is not one]
        middle = self._on_stage(place)
        sides = look_sides_m(place, others, touch_distance_m(self._tip, one.radius_m, 0.0))
        look = self._bench.image(middle, sides, _LOOK_PIXELS, _LOOK_LINES)
        self._looks += 1
        seen = [(math.dist((found.x_m, found.y_m), middle), found, time_s) for found, time_s in self._seen(look)]
        if not seen or min(seen)[0] > 2.0 * one.radius_m:
            return False
        _, found, time_s = min(seen)
        if not was_pushed:
            self._follow_drift(one, found, time_s)
        self._known[particle] = one._replace(x_m=found.x_m, y_m=found.y_m, radius_m=found.radius_m, seen_s=time_s)
        return True

    def _follow_drift(self, before: _Known, particle: FoundParticle, time_s: float) -> None:
        ahead, elapsed_s = drift_at(self._drift, time_s), time_s - before.seen_s
        x_error, y_error = max(particle.x_error_m, _LEAST_ERROR_M), max(particle.y_error_m, _LEAST_ERROR_M)
        self._drift = Drift(
            ahead.time_s,
            moved(ahead.x, particle.x_m - before.x_m, elapsed_s, math.sqrt(2.0) * x_error),
            moved(ahead.y, particle.y_m - before.y_m, elapsed_s, math.sqrt(2.0) * y_error),
        )

    def _outcome(self, before: Look, after: Look) -> Assembly:
        placed = []
        for target in self._targets:
            near = min(self._known, key=lambda one: math.dist(self._place(one), target), default=None)
            if near is None:
                raise UnreachableError("no particle is left in the image")
            place = self._place(near)
            placed.append(TargetPlacement(target, place, math.dist(place, target), near.pushes))
        return Assembly(
            tuple(placed),
            after.ended_s - before.began_s,
            self._pushes,
            self._looks,
            self._losses,
            self._drift,
            before,
            after,
        )

"""Force curves: approach and retraction of the simulated tip, the points C and D of Fig. 5, and the energy of the loop.

"The tip contacts with the sample at the point C and leaves it at D during retracting" (section 3 of the paper). C is
the snap-in, where the tip jumps to the sample or to its water layer. D is the last jump of the force on retraction,
where the meniscus breaks, or, where nothing jumps, the pull-off. Two more places are marked that the paper does not
name: the pull-off, which is the strongest pull on retraction, and the place where the force passes zero there.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.afm import settled_tip, simulated_afm
from telenano.sections import AfmConfig
from telenano.settings import read_by_package
from telenano.wire import ConfigError, RigError

Array = npt.NDArray[np.float64]

# A step of the force on retraction counts as the break only above this share of the greatest step.
_JUMP_SHARE = 0.5
# Constants that a file of a curve may lack.
CONSTANTS = ("stiffness_n_per_m", "sensitivity_m_per_v")
# Facts of a text table that the user gives because its header lacks them.
OF_TABLES = ("columns", "way_unit", "value_unit", "value_sign")
# A tenth of a piconewton is below the thermal force of any lever.
_LEAST_LOAD_N = 1e-13
# Default speed [m/s]; at the 50 nm/s of a program, the dynamic cantilever takes four times as long to compute.
_SPEED_M_PER_S = 200e-9


@dataclass(frozen=True)
class Half:
    """One branch of a curve in the order of time: base x_s towards the sample [m], deflection [m], tip force [N]."""

    base_m: Array
    deflection_m: Array
    force_n: Array


@dataclass(frozen=True)
class Curve:
    """Approach and retraction, the constants of the measurement, and remarks on assumptions made in reading a file."""

    approach: Half
    retract: Half
    stiffness_n_per_m: float
    rest_distance_m: float
    speed_m_per_s: float
    model: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Marks:
    """Base x_s [m] and force [N] of each mark, and the energy of the loop [J]; None where a curve has no such point.

    snap_in: C of Fig. 5; break: the last jump of the retraction; contact: the place where its force passes zero;
    pull_off: its strongest pull.
    """

    snap_in_base_m: float | None
    snap_in_force_n: float | None
    contact_base_m: float | None
    pull_off_base_m: float
    pull_off_force_n: float
    break_base_m: float | None
    hysteresis_j: float

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def force_curve(
    config: AfmConfig,
    start_m: float,
    load_n: float,
    points: int = 1000,
    speed_m_per_s: float = _SPEED_M_PER_S,
    *,
    dynamic: bool = False,
    progress: Callable[[int, int], None] = lambda n, of: None,
) -> Curve:
    """Simulate a curve that begins start_m above the rest point and turns where the force reaches load_n.

    If the configuration has disturbances, each point is a sample of the disturbed instrument at the time that follows
    from the speed.

    Args:
        config: The instrument.
        start_m: Height of the beginning above the rest point [m].
        load_n: Force at which the base turns [N].
        points: Number of points of each branch.
        speed_m_per_s: Speed of the base [m/s].
        dynamic: Whether Eq. 4 is solved in full instead of k zeta = F(h). The base then rests at each point until the
            cantilever has come to rest, and the speed only sets the times in the data.
        progress: Called with the number of finished points and their total.

    Raises:
        ConfigError: The tip cannot reach the load, an argument is out of range, or a dynamic curve is to be disturbed.
    """
    for name, value in (("start [m]", start_m), ("load [N]", load_n), ("speed [m/s]", speed_m_per_s)):
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(f"{name} = {value:g} must be positive and finite")
    if not 10 <= points <= 100_000:
        raise ConfigError(f"{points} points a way are outside 10 to 100000")
    if load_n < _LEAST_LOAD_N:
        raise ConfigError(f"a load of {load_n:.3g} N is below what any tip feels: is it in nN, as --load takes it?")
    if load_n > config.safety.force_limit_n:
        raise ConfigError(f"a load of {load_n:g} N is above safety.force_limit_n = {config.safety.force_limit_n:g} N")
    plant = config.to_params().plant
    begin = -start_m
    end = _turning_point(config, load_n)
    if end <= begin:
        raise ConfigError(f"the curve begins at x_s = {begin:g} m, beyond the load at {end:g} m: begin further away")
    there = np.linspace(begin, end, points)
    if dynamic and config.disturbances.any_enabled:
        raise ConfigError("disturbances: only the quasi-static model of a curve has them: leave out --model dynamic")
    measure = _dynamic(config, begin) if dynamic else _static(config, begin)
    if config.disturbances.any_enabled:
        measure = _disturbed(config, float(there[1] - there[0]) / speed_m_per_s)
    ways = []
    for number, way in enumerate((there, there[::-1])):
        zeta = np.empty(points)
        for i, base in enumerate(way.tolist()):
            zeta[i] = measure(base)
            if i % 50 == 49:
                progress(number * points + i + 1, 2 * points)
        ways.append(Half(way.copy(), zeta, plant.stiffness_n_per_m * zeta))
    model = "dynamic" if dynamic else "quasi_static"
    return Curve(ways[0], ways[1], plant.stiffness_n_per_m, plant.rest_distance_m, speed_m_per_s, model)


def curve_of_samples(
    base_m: Sequence[float], deflection_m: Sequence[float], force_n: Sequence[float], start_m: float, speed: float
) -> Curve:
    """Return the curve in the samples of an instrument that went down from start_m [m] and back at a speed [m/s].

    Samples before the base went down and after it was back are dropped, and so are those in which it did not move.
    RigError is raised if either branch has fewer than 10 samples.
    """
    base, zeta, force = (np.asarray(values, dtype=np.float64) for values in (base_m, deflection_m, force_n))
    turn = int(np.argmax(base)) if len(base) else 0
    below = np.flatnonzero(base[:turn] <= start_m)
    first = int(below[-1]) if len(below) else 0
    back = np.flatnonzero(base[turn:] <= start_m)
    last = turn + int(back[0]) if len(back) else len(base) - 1
    halves = []
    for way in (slice(first, turn + 1), slice(turn, last + 1)):
        moved = np.flatnonzero(np.diff(base[way], prepend=np.nan) != 0.0)
        if len(moved) < 10:
            raise RigError("fewer than 10 samples were taken on one way of the curve: give a lower speed")
        halves.append(Half(base[way][moved], zeta[way][moved], force[way][moved]))
    far = zeta[way] != 0.0
    k = float(np.median(force[way][far] / zeta[way][far])) if far.any() else 0.0
    return Curve(halves[0], halves[1], k, 0.0, speed, "live")


def _static(config: AfmConfig, begin_m: float) -> Callable[[float], float]:
    plant = config.to_params().plant
    state = plant.at_rest(begin_m)

    def measure(base_m: float) -> float:
        nonlocal state
        state = plant.settled(state, base_m)
        return float(state.distance_m + base_m - plant.rest_distance_m)

    return measure


def _disturbed(config: AfmConfig, step_s: float) -> Callable[[float], float]:
    """Return a function that reads the deflection [m] at a base [m], step_s [s] after the call before it."""
    driver = simulated_afm(config.to_params(), disturbances=config.disturbances)
    driver.open()

    def measure(base_m: float) -> float:
        driver.elapse(step_s)
        return driver.exchange(base_m).deflection_m

    return measure


def _dynamic(config: AfmConfig, begin_m: float) -> Callable[[float], float]:
    try:
        plant = config.to_dynamic()
        # After Q periods a motion has decayed to e^-pi of its amplitude.
        settle = max(1, round(config.cantilever.quality / 2.0)) * plant.drive.shape[0]
        return settled_tip(plant, begin_m, settle)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _turning_point(config: AfmConfig, load_n: float) -> float:
    """Return the base x_s [m] at which the sample pushes the tip with load_n [N], by bisection on the static curve."""
    plant = config.to_params().plant
    low = config.rest_distance_m
    high = low + 1e-9
    deep = plant.settled(plant.at_rest(low), low)

    def force(base_m: float) -> float:
        zeta_m = plant.settled(deep, base_m).distance_m + base_m - plant.rest_distance_m
        return float(plant.stiffness_n_per_m * zeta_m)

    while force(high) < load_n:
        high = low + 2.0 * (high - low)
        if high - low > 1e-4:
            raise ConfigError(f"no base within 0.1 mm pushes the tip with {load_n:g} N")
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if force(middle) < load_n else (low, middle)
    return high


def marks_of(curve: Curve) -> Marks:
    """Return the marks of a curve and the energy of its loop, computed from force against base alone."""
    down, up = curve.approach, curve.retract
    steps = np.diff(down.force_n)
    snap = int(np.argmin(steps))
    has_snap = _is_jump(steps, snap)
    pull = int(np.argmin(up.force_n))
    pushed = np.flatnonzero(up.force_n[:pull] > 0.0)
    jumps = np.diff(up.force_n[pull:])
    large = np.flatnonzero(jumps > _JUMP_SHARE * float(jumps.max())) if len(jumps) else np.zeros(0, int)
    broken = len(large) > 0 and _is_jump(jumps, int(large[-1]))
    # The loop integral over both branches is the work of the base on the cantilever that it does not get back.
    loop = float(np.trapezoid(down.force_n, down.base_m) + np.trapezoid(up.force_n, up.base_m))
    return Marks(
        float(down.base_m[snap]) if has_snap else None,
        float(down.force_n[snap + 1]) if has_snap else None,
        float(up.base_m[pushed[-1]]) if len(pushed) else None,
        float(up.base_m[pull]),
        float(up.force_n[pull]),
        float(up.base_m[pull + int(large[-1])]) if broken else None,
        loop,
    )


def _is_jump(steps: Array, at: int) -> bool:
    """Return whether a step of the force stands alone: on a branch, however steep, steps change gradually."""
    around = [abs(float(steps[i])) for i in (at - 3, at - 2, at + 2, at + 3) if 0 <= i < len(steps)]
    return bool(around) and abs(float(steps[at])) > 5.0 * max(around) + 1e-12


def write_hdf5(path: Path, curve: Curve) -> None:
    """Write a curve in the layout of afmformats: one group, columns in SI units, metadata as attributes."""
    from importlib.metadata import version

    import h5py

    down, up = curve.approach, curve.retract
    points = len(down.base_m)
    step_s = abs(float(down.base_m[1] - down.base_m[0])) / curve.speed_m_per_s
    with h5py.File(path, "w") as file:
        file.attrs["software"] = "telenano"
        file.attrs["software version"] = version("telenano")
        group = file.create_group("0")
        # `height (measured)` rises away from the sample.
        group["force"] = np.concatenate([down.force_n, up.force_n])
        group["height (measured)"] = -np.concatenate([down.base_m, up.base_m])
        group["segment"] = np.repeat(np.array([0, 1], dtype=np.uint8), points)
        group["time"] = np.arange(2 * points) * step_s
        for name, unit in (("force", "N"), ("height (measured)", "m"), ("segment", ""), ("time", "s")):
            group[name].attrs["unit"] = unit
        metadata = {
            "enum": 0,
            "imaging mode": "force-distance",
            "point count": 2 * points,
            "spring constant": curve.stiffness_n_per_m,
            "speed approach": curve.speed_m_per_s,
            "speed retract": curve.speed_m_per_s,
            "duration": 2 * points * step_s,
        }
        group.attrs.update(metadata)


def read_measured(path: Path, number: int = 0, constants: Mapping[str, Any] | None = None) -> Curve:
    """Return a measured curve from a file that the reader of an installed package understands.

    Args:
        path: The file.
        number: Index of the curve in a map, from 0.
        constants: `stiffness_n_per_m` and `sensitivity_m_per_v`, used instead of those of the file; for a text table
            also `columns`, `way_unit`, `value_unit` and `value_sign`, which its header does not say.

    Raises:
        ConfigError: The file cannot be read or is not a complete curve; the message names the file and the reason.
    """
    constants = constants or {}
    table = {name: str(value) for name, value in constants.items() if name in OF_TABLES}
    if unknown := [name for name in constants if name not in (*CONSTANTS, *OF_TABLES)]:
        names = ", ".join((*CONSTANTS, *OF_TABLES))
        raise ConfigError(f"--set {unknown[0]}: is not a constant of a curve; these are {names}")
    for name, value in constants.items():
        if name in CONSTANTS and not (isinstance(value, int | float) and 0.0 < value < math.inf):
            raise ConfigError(f"--set {name}: is {value!r}; it must be a number above 0")
    texts = [repr(float(constants[name])) if name in constants else "" for name in CONSTANTS]
    texts += [json.dumps(table)] if table else []
    try:
        facts, (base, deflection) = read_by_package(path, "curve", str(number), *texts)
        curve = _measured(base, deflection, facts["stiffness_n_per_m"], facts["turn"], facts["speed_m_per_s"])
        curve = replace(curve, remarks=tuple(facts.get("remarks", ())))
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    # Readers raise exceptions of any kind on damaged files.
    except Exception as error:
        raise ConfigError(f"{path}: is not a complete force curve: {error}") from error
    for half in (curve.approach, curve.retract):
        if not (len(half.base_m) >= 10 and np.isfinite(half.base_m).all() and np.isfinite(half.force_n).all()):
            raise ConfigError(f"{path}: a way of the curve has fewer than 10 points, or some that are no number")
    return curve


def _measured(base: Array, deflection: Array, k: float, turn: int, speed: float) -> Curve:
    if not 0.0 < k < math.inf:
        raise ValueError(f"its spring constant is {k:g} N/m; it must be above 0 N/m")
    # The curve begins far from the sample, where there is no force.
    zeta = deflection - float(np.median(deflection[: max(turn // 10, 2)]))
    ways = (slice(0, turn), slice(turn, None))
    halves = [Half(base[way], zeta[way], k * zeta[way]) for way in ways]
    return Curve(halves[0], halves[1], k, 0.0, speed, "measured")

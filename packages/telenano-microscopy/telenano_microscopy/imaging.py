"""One line of an image: the feedback that holds amplitude or force while the tip goes there and back.

What the base does is the picture: height = -x_s, up to a constant. The feedback (`feedback`) is that of an image on the
bus, here within the range and speed of a piezo and more often.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.physics.cantilever import Plant, PlantState, deflection_m, equilibrium
from services.afm_node.physics.contact.friction import FrictionParams, FrictionState, friction_step
from services.afm_node.physics.dynamic import DynamicState, advance, lag_rad
from services.afm_node.physics.dynamic_plant import NORMALS_PER_PERIOD, DynamicPlant
from services.afm_node.physics.sample.surface import height_at
from services.afm_node.programs.feedback import carried_out, feedback_step
from services.numerics.compiled import always_compiled, compiled

Array = npt.NDArray[np.float64]

# columns of a line
HEIGHT, ERROR, AMPLITUDE, PHASE, DISSIPATED, FORCE, LATERAL = range(7)
CHANNELS = 7


class Feedback(NamedTuple):
    """Set-point [m], of amplitude or deflection; gains Ki and Kp; greatest speed [m/s] and range of the base [m]."""

    setpoint_m: float
    gain_per_s: float
    proportional: float
    speed_m_per_s: float
    base_min_m: float
    base_max_m: float


class Line(NamedTuple):
    """Ends of a line on the map [m], its pixels, and the feedback's periods on each."""

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float
    pixels: int
    periods: int


@compiled
def regulated(
    feedback: Feedback, base_m: float, proportional_m: float, error_m: float, dt: float
) -> tuple[float, float]:
    """Return where the base goes within dt [s], within range and speed, and the proportional part in that."""
    share = feedback.gain_per_s * dt
    wanted, part = feedback_step(base_m, proportional_m, error_m, share, feedback.proportional)
    reach = feedback.speed_m_per_s * dt
    near = min(max(wanted, base_m - reach), base_m + reach)
    base = min(max(near, feedback.base_min_m), feedback.base_max_m)
    return base, carried_out(part, wanted - base)


@compiled
def require_rows(line: Line, first: int, out: Array) -> None:
    """Raise ValueError where `out` is no rows of all channels for pixels of the line: compiled code would go beyond."""
    if first < 0 or first + out.shape[0] > line.pixels or out.shape[1] != CHANNELS:
        raise ValueError("a line needs a row of all channels for each of its pixels")


@always_compiled
def tapping_line(
    plant: DynamicPlant,
    state: DynamicState,
    proportional_m: float,
    error_m: float,
    feedback: Feedback,
    line: Line,
    height_m: Array,
    step_x_m: float,
    step_y_m: float,
    drive_m: float,
    normals: Array,
    first: int,
    out: Array,
) -> tuple[DynamicState, float, float]:
    """Scan pixels of a line in tapping mode, the feedback acting once in each period of the drive.

    Args:
        plant: The dynamic cantilever.
        state: Its state at the first of the pixels.
        proportional_m: The proportional part of the feedback in the base so far [m].
        error_m: The error so far [m].
        feedback: The constants of the feedback.
        line: The line that is scanned.
        height_m: The height map as the tip sees it [m], shape (rows, columns).
        step_x_m: The distance of its columns [m].
        step_y_m: The distance of its rows [m].
        drive_m: The amplitude of the base's vibration [m].
        normals: Normal numbers of thermal noise, sixteen for each period, or none.
        first: The first pixel that is scanned.
        out: Filled with as many pixels as it has rows, from `first` on, shape (pixels, CHANNELS).

    Returns:
        The state, the proportional part [m] and the error [m] after the last pixel.
    """
    steps = plant.drive.shape[0]
    dt = steps * plant.step_s
    require_rows(line, first, out)
    total = line.pixels * line.periods
    n, begun = first * line.periods, first * line.periods
    for i in range(out.shape[0]):
        sums = np.zeros(CHANNELS)
        for _ in range(line.periods):
            share = (n + 1.0) / total
            x, y = line.x0_m + share * (line.x1_m - line.x0_m), line.y0_m + share * (line.y1_m - line.y0_m)
            surface = height_at(height_m, step_x_m, step_y_m, x, y)[0]
            base, proportional_m = regulated(feedback, state.base_m, proportional_m, error_m, dt)
            kick = (n - begun) * NORMALS_PER_PERIOD
            noise = normals[kick : kick + NORMALS_PER_PERIOD] if normals.size > 0 else normals
            before = state.base_m
            state, reading = advance(plant, state, base, surface, drive_m, steps, noise)
            amplitude = math.hypot(reading.in_phase_m, reading.quadrature_m)
            error_m = amplitude - feedback.setpoint_m
            sums[HEIGHT] -= 0.5 * (before + base)
            sums[ERROR] += error_m
            sums[AMPLITUDE] += amplitude
            sums[PHASE] += lag_rad(reading.in_phase_m, reading.quadrature_m)
            sums[DISSIPATED] += reading.dissipated_j
            sums[FORCE] += reading.peak_force_n
            n += 1
        for c in range(CHANNELS):
            out[i, c] = sums[c] / line.periods
    return state, proportional_m, error_m


@always_compiled
def contact_line(
    plant: Plant,
    state: PlantState,
    base_m: float,
    proportional_m: float,
    error_m: float,
    feedback: Feedback,
    line: Line,
    height_m: Array,
    step_x_m: float,
    step_y_m: float,
    dt: float,
    friction: FrictionParams,
    held: FrictionState,
    first: int,
    out: Array,
) -> tuple[PlantState, float, float, float, FrictionState]:
    """Scan pixels of a line in contact at a constant force, with the quasi-static cantilever; fill `out` from `first`.

    A surface that rises by s is to the tip what a base is that comes nearer by s. LATERAL is the force along the line's
    axis x, of slope and friction.

    Args:
        plant: The quasi-static cantilever.
        state: Its state at the first of the pixels.
        base_m: The base so far [m].
        proportional_m: The proportional part of the feedback in the base so far [m].
        error_m: The error so far [m].
        feedback: The constants of the feedback.
        line: The line that is scanned.
        height_m: The height map as the tip sees it [m], shape (rows, columns).
        step_x_m: The distance of its columns [m].
        step_y_m: The distance of its rows [m].
        dt: The period of the feedback [s].
        friction: The parameters of friction.
        held: The state of the tip that friction holds back.
        first: The first pixel that is scanned.
        out: Filled with as many pixels as it has rows, from `first` on, shape (pixels, CHANNELS).

    Returns:
        The state, the base [m], the proportional part [m], the error [m] and the state of friction after the last
        pixel.
    """
    require_rows(line, first, out)
    total = line.pixels * line.periods
    n = first * line.periods
    moved_x, moved_y = (line.x1_m - line.x0_m) / total, (line.y1_m - line.y0_m) / total
    for i in range(out.shape[0]):
        height, error, force, lateral = 0.0, 0.0, 0.0, 0.0
        for _ in range(line.periods):
            share = (n + 1.0) / total
            x, y = line.x0_m + share * (line.x1_m - line.x0_m), line.y0_m + share * (line.y1_m - line.y0_m)
            surface, slope_x, slope_y = height_at(height_m, step_x_m, step_y_m, x, y)
            base_m, proportional_m = regulated(feedback, base_m, proportional_m, error_m, dt)
            state = equilibrium(plant, state, base_m + surface)
            zeta = deflection_m(plant, state.distance_m, base_m + surface)
            error_m = feedback.setpoint_m - zeta
            height -= base_m
            error += error_m
            load = plant.stiffness_n_per_m * zeta
            held, sideways, _ = friction_step(friction, held, moved_x, moved_y, load, slope_x, slope_y, state.contact)
            force += load
            lateral += sideways
            n += 1
        out[i, HEIGHT], out[i, ERROR] = height / line.periods, error / line.periods
        out[i, FORCE], out[i, LATERAL] = force / line.periods, lateral / line.periods
    return state, base_m, proportional_m, error_m, held

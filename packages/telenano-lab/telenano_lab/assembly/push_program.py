"""A program that pushes a particle to a goal: the tip goes behind the particle, touches the surface, and pushes.

The program knows only the believed place of the particle and its radius. The tip comes down behind it until it touches
the surface, rises to the height of the push, and moves on. The lateral force F on the tip tells the rest: the particle
lies in the direction -F at the distance d (that of the axes of a tip and a sphere that touch). Modes:

- *straight*: along the line from the believed place to the goal. A particle that lies beside it slips off.
- *steered*: the tip turns the particle towards the goal (`telenano_lab.assembly.particles.steering`).
- *sweep*: lines at right angles to the push, each nearer to the goal than the last by a share of d, so that a
  lateral offset of the particle does not matter.
"""

import math
from typing import Literal, NamedTuple

from pydantic import Field

from telenano.extend.feedback import gain_fault, integral_share
from telenano.extend.programs import (
    Begun,
    Force,
    Inputs,
    Instrument,
    Length,
    Position,
    Program,
    ProgramSettings,
    Progress,
    Speed,
    Wanted,
    Way,
)
from telenano.extend.stage import Place
from telenano.wire import RefusedError, Scalar
from telenano_lab.assembly.particles.steering import steered
from telenano_lab.assembly.particles.tip_shape import TipShape, tip_shape, touch_distance_m

# Phases after the approach to the surface.
LIFT = Way.ARRIVED
PUSH = Way.ARRIVED + 1
DONE = Way.ARRIVED + 2
# Reasons for which a push ends.
AT_GOAL = "the particle is at its goal"
LOST = "the particle is lost"
TOO_FAR = "the way is longer than planned"
NOT_MET = "no particle was met"
PASSED = "the particle has passed its goal"

# The approach point lies this many d behind the believed place.
_BEHIND = 1.3
# A push is given up if its path is longer than planned by this factor.
_LONGEST = 1.5
# The particle is lost when the lateral force stays below this share of its plateau.
_LOST_SHARE = 0.3
# The force has to stay that low for this share of d.
_LOST_WAY = 0.05
# The particle is also lost when it lies this far aside of the tip's direction.
_LOST_RAD = math.radians(75.0)
# The plateau and the direction of the force are means over this share of d.
_MEAN_WAY = 0.02
# A lateral force is a contact above this number of standard deviations of the noise before it.
_CONTACT_DEVIATIONS = 3.0
# The force has to be that high for this number of steps.
_CONTACT_STEPS = 3
# The forces before a contact are averaged over this number of steps before a contact counts.
_QUIET_STEPS = 10
# A contact also exceeds the deviations by this force, so that a noise of zero leaves a threshold.
_LEAST_N = 1e-11
# The lines of a sweep go this many d to either side, so that their ends are clear of the particle.
_HALF_LINE = 2.5
# A steered particle that can come no nearer has arrived if it is within this share of its radius.
_NEAR = 0.2


class PushSettings(ProgramSettings):
    """A push of one particle."""

    mode: Literal["straight", "steered", "sweep"] = Field(
        "steered", description="straight: along the line; steered: by the force that is felt; sweep: lines across."
    )
    x0_m: Position = Field(0.0, description="Assumed place of the particle [m].")
    y0_m: Position = Field(0.0, description="Assumed place of the particle [m].")
    x1_m: Position = Field(1e-6, description="Goal of the particle [m].")
    y1_m: Position = Field(0.0, description="Goal of the particle [m].")
    radius_m: Length = Field(250e-9, description="Radius of the particle [m].")
    tip_radius_m: Length = Field(10e-9, description="Radius of the apex of the tip [m].")
    cone_deg: float = Field(15.0, ge=1.0, le=60.0, description="Half-angle of the tip behind its apex [degrees].")
    hold: Literal["height", "force"] = Field(
        "height", description="height: the apex stays height_m above the surface; force: it presses with setpoint_n."
    )
    height_m: float = Field(5e-9, ge=0.0, le=1e-6, description="Height of the apex in a push [m].")
    setpoint_n: Force = Field(12e-9, description="Force of the touch, and of a push with hold=force [N].")
    speed_m_per_s: Speed = Field(2e-6, description="Speed of the tip [m/s].")
    approach_m_per_s: Speed = Field(500e-9, description="Speed of the approach [m/s].")
    stop_on_loss: bool = Field(True, description="Whether the push ends where the particle is lost.")
    lateral_limit_n: float = Field(200e-9, gt=0.0, le=1e-3, description="Lateral force at which the push ends [N].")
    tolerance_m: Length = Field(5e-9, description="Distance from the goal at which the particle has arrived [m].")
    gain_per_s: float = Field(400.0, gt=0.0, le=1e5, description="Gain of the feedback with hold=force [1/s].")
    pitch: float = Field(0.25, gt=0.0, lt=1.0, description="Distance of the lines of a sweep, as a share of d.")


class PushPlan(NamedTuple):
    """A push: its settings, distance d of the axes [m], start of the tip, and facts of the instrument."""

    settings: PushSettings
    distance_m: float
    start: Place
    way_m: float
    stiffness_n_per_m: float
    lateral_uncertainty: float
    clear_m: float
    approach_s: float
    speed_m_per_s: float
    period_s: float
    tip: TipShape


class PushState(NamedTuple):
    """Phase, time in it [s], base at the touch [m]; the felt forces, and the believed place of the particle.

    gone_m: path of the tip in the push [m]. force_x_n, force_y_n: mean lateral force [N]; plateau_n: its mean size
    since contact; peak_n: the largest. quiet: count, mean along x and y [N], and sum of squared deviations of the
    lateral force before contact, which is the reading of the channel without a particle: crosstalk, friction of the
    tip, noise.
    That mean is subtracted from all other forces. steps: steps above the threshold; faint_m: path without force [m].
    line: index of the line of a sweep. why: reason of the end. aside_rad: angle from the motion of the tip to the
    particle.
    """

    phase: int
    elapsed_s: float
    touched_m: float
    gone_m: float
    force_x_n: float
    force_y_n: float
    plateau_n: float
    peak_n: float
    quiet: tuple[int, float, float, float]
    steps: int
    faint_m: float
    believed: Place
    place: Place
    line: int
    why: str
    aside_rad: float = 0.0

    @property
    def in_contact(self) -> bool:
        return self.steps >= _CONTACT_STEPS


class Push(Program[PushSettings, PushPlan, PushState]):
    """A push of a particle."""

    settings = PushSettings
    title = "Push"
    about = "A particle that the tip pushes."
    can_pause = True
    leaves_tip = True
    moves_across = True

    def begin(self, settings: PushSettings, instrument: Instrument, place: Place) -> Begun[PushPlan, PushState]:
        s, limits = settings, instrument.limits
        if instrument.lateral is None:
            raise RefusedError("program: push needs a lateral stage, and this instrument has none")
        way = math.hypot(s.x1_m - s.x0_m, s.y1_m - s.y0_m)
        if way <= s.tolerance_m:
            raise RefusedError(
                f"push: the particle is within push.tolerance_m = {s.tolerance_m:g} m of its goal already"
            )
        if not 0.0 < s.setpoint_n < limits.force_limit_n:
            raise RefusedError(
                f"push.setpoint_n must lie between 0 and safety.force_limit_n = {limits.force_limit_n:g} N"
            )
        tip = tip_shape(s.tip_radius_m, math.radians(s.cone_deg))
        distance = touch_distance_m(tip, s.radius_m, s.height_m)
        if distance <= 0.0:
            raise RefusedError(f"push.height_m = {s.height_m:g} m is above a particle of radius {s.radius_m:g} m")
        back = _BEHIND * distance / way
        start = Place(s.x0_m - back * (s.x1_m - s.x0_m), s.y0_m - back * (s.y1_m - s.y0_m))
        reach_m, fastest = instrument.lateral
        furthest = max(abs(value) for value in (*start, s.x1_m, s.y1_m))
        if furthest > reach_m:
            raise RefusedError(f"push: it reaches {furthest:.3g} m, and lateral.reach_m is {reach_m:g} m")
        width_m, depth_m = instrument.size_m
        has_surface = instrument.reach is not None and instrument.reach.surface is not None
        if has_surface and (abs(s.x1_m) > 0.5 * width_m or abs(s.y1_m) > 0.5 * depth_m):
            raise RefusedError(
                f"push: its goal at {s.x1_m:g}, {s.y1_m:g} m lies outside of the sample of {width_m:g} x {depth_m:g} m,"
                " whose middle is 0, 0"
            )
        plan = PushPlan(
            settings=s,
            distance_m=distance,
            start=start,
            way_m=way + (_BEHIND - 1.0) * distance,
            stiffness_n_per_m=instrument.stiffness_n_per_m,
            lateral_uncertainty=instrument.lateral_uncertainty,
            clear_m=limits.retract_position_m,
            approach_s=instrument.approach_limit_s(s.approach_m_per_s),
            speed_m_per_s=min(s.speed_m_per_s, fastest),
            period_s=instrument.period_s,
            tip=tip,
        )
        if s.hold == "force" and (fault := gain_fault(s.gain_per_s, 0.0, plan.period_s, None, ("push.gain_per_s", ""))):
            raise RefusedError(f"push: {fault}")
        if instrument.reach is not None:
            here = instrument.reach.along(start, Place(s.x1_m, s.y1_m))
            fault = instrument.reach.depth_fault(here, s.setpoint_n / plan.stiffness_n_per_m)
            if fault := fault or instrument.reach.retracted_fault(here):
                raise RefusedError(f"push: {fault}")
        state = PushState(
            Way.RISE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (0, 0.0, 0.0, 0.0), 0, 0.0, Place(s.x0_m, s.y0_m), start, 0, ""
        )
        return Begun(plan, state, f"the tip pushes a particle {way:.3g} m, {s.mode}")

    def step(self, plan: PushPlan, state: PushState, inputs: Inputs, dt: float) -> Wanted[PushState]:
        s = plan.settings
        if state.phase <= Way.APPROACH:
            touches, step_m = inputs.force_n >= s.setpoint_n, s.approach_m_per_s * dt
            way = Way.to_surface(state.phase, state.elapsed_s, inputs, plan.start, plan.clear_m, step_m, touches, dt)
            state = state._replace(phase=way.phase, elapsed_s=way.elapsed_s, touched_m=inputs.base_m)
            return Wanted(state, way.base_m, way.place)
        base_m = _base_m(plan, state, inputs, dt)
        if state.phase == LIFT:
            arrived = s.hold == "force" or abs(inputs.base_m - base_m) < 1e-12
            return Wanted(state._replace(phase=PUSH if arrived else LIFT, place=inputs.place), base_m, plan.start)
        if state.phase == DONE or inputs.is_paused:
            return Wanted(state, base_m, inputs.place, state.phase == DONE)
        state = _felt(plan, state, inputs)
        why = _ended(plan, state, math.hypot(*inputs.lateral_n))
        if why:
            return Wanted(state._replace(phase=DONE, why=why), base_m, inputs.place, True)
        state, target = _onwards(plan, state, dt)
        return Wanted(state, base_m, target)

    def progress(self, plan: PushPlan, state: PushState) -> Progress:
        felt = "pushing" if state.in_contact else "on the way to the particle"
        texts = (*Way.TEXTS, "the tip goes to its height", felt, state.why or "done")
        felt_once = state.plateau_n > 0.0
        values: dict[str, Scalar] = {
            "in_contact": state.in_contact,
            "why": state.why,
            "plateau_n": state.plateau_n,
            "peak_n": state.peak_n,
            # Size: calibration and noise; direction, and so the place: noise alone.
            "plateau_error_n": math.hypot(plan.lateral_uncertainty * state.plateau_n, _noise_n(state)),
            "aside_rad": state.aside_rad,
            "believed_x_m": state.believed.x_m,
            "believed_y_m": state.believed.y_m,
            "believed_error_m": plan.distance_m * min(_noise_n(state) / state.plateau_n, 1.0) if felt_once else 0.0,
        }
        return Progress(texts[state.phase], min(state.gone_m / plan.way_m, 1.0), values=values)

    def searching_s(self, plan: PushPlan, state: PushState) -> tuple[float, float]:
        return (state.elapsed_s if state.phase == Way.APPROACH else 0.0), plan.approach_s

    def shortfall(self, plan: PushPlan, state: PushState) -> str:
        return "" if state.why in ("", AT_GOAL) else f": {state.why}"


def _base_m(plan: PushPlan, state: PushState, inputs: Inputs, dt: float) -> float:
    """Return the next position of the base [m]: a height above the touched surface, or one that holds the force."""
    s = plan.settings
    if s.hold == "height":
        return state.touched_m - s.setpoint_n / plan.stiffness_n_per_m - s.height_m
    share = integral_share(s.gain_per_s, 0.0, plan.period_s, None, dt)
    return inputs.base_m + (s.setpoint_n - inputs.force_n) / plan.stiffness_n_per_m * share


def _felt(plan: PushPlan, state: PushState, inputs: Inputs) -> PushState:
    """Update the state with the lateral force of the last step."""
    place, (count, rest_x, rest_y, squares) = inputs.place, state.quiet
    force_x, force_y = inputs.lateral_n[0] - rest_x, inputs.lateral_n[1] - rest_y
    way, size = math.dist(place, state.place), math.hypot(force_x, force_y)
    state = state._replace(place=place, gone_m=state.gone_m + way, peak_n=max(state.peak_n, size))
    if not state.in_contact:
        if count < _QUIET_STEPS or size <= _CONTACT_DEVIATIONS * _noise_n(state) + _LEAST_N:
            share = 1.0 / (count + 1)
            squares += (1.0 - share) * size * size
            return state._replace(
                quiet=(count + 1, rest_x + share * force_x, rest_y + share * force_y, squares), steps=0
            )
        state = state._replace(steps=state.steps + 1, force_x_n=force_x, force_y_n=force_y, plateau_n=size)
    if size < _LOST_SHARE * state.plateau_n:
        return state._replace(faint_m=state.faint_m + way)
    share = 1.0 - math.exp(-way / (_MEAN_WAY * plan.distance_m))
    mean_x = state.force_x_n + share * (force_x - state.force_x_n)
    mean_y = state.force_y_n + share * (force_y - state.force_y_n)
    # The flank has lifted the apex by the deflection of its load.
    apex_m = plan.settings.height_m + max(inputs.force_n, 0.0) / plan.stiffness_n_per_m
    held = plan.settings.hold == "force"
    reach = touch_distance_m(plan.tip, plan.settings.radius_m, 0.0 if held else apex_m) / math.hypot(mean_x, mean_y)
    return state._replace(
        force_x_n=mean_x,
        force_y_n=mean_y,
        plateau_n=state.plateau_n + share * (size - state.plateau_n),
        faint_m=0.0,
        believed=Place(place.x_m - reach * mean_x, place.y_m - reach * mean_y),
    )


def _noise_n(state: PushState) -> float:
    """Return the standard deviation of the lateral force without a particle [N]."""
    return math.sqrt(state.quiet[3] / max(state.quiet[0], 1))


def _ended(plan: PushPlan, state: PushState, size_n: float) -> str:
    """Return the reason why the push is over; empty if it continues."""
    s, goal = plan.settings, Place(plan.settings.x1_m, plan.settings.y1_m)
    if size_n > s.lateral_limit_n:
        return f"the lateral force is above push.lateral_limit_n = {s.lateral_limit_n:g} N"
    if s.mode == "sweep":
        return AT_GOAL if state.line >= _lines(plan) else ""
    if not state.in_contact:
        return NOT_MET if state.gone_m > (_BEHIND + 1.0) * plan.distance_m else ""
    if s.stop_on_loss and (state.faint_m > _LOST_WAY * plan.distance_m or abs(state.aside_rad) > _LOST_RAD):
        return LOST
    to_x, to_y = goal.x_m - state.believed.x_m, goal.y_m - state.believed.y_m
    ahead = -(to_x * state.force_x_n + to_y * state.force_y_n)
    if math.hypot(to_x, to_y) <= s.tolerance_m or (s.mode == "straight" and state.gone_m >= plan.way_m):
        return AT_GOAL
    if s.mode == "steered" and ahead <= 0.0:
        return AT_GOAL if math.hypot(to_x, to_y) <= _NEAR * s.radius_m else PASSED
    return TOO_FAR if state.gone_m > _LONGEST * plan.way_m else ""


def _onwards(plan: PushPlan, state: PushState, dt: float) -> tuple[PushState, Place]:
    """Return the state and the next place of the stage."""
    s = plan.settings
    step_m, bearing = plan.speed_m_per_s * dt, math.atan2(s.y1_m - s.y0_m, s.x1_m - s.x0_m)
    if s.mode == "sweep":
        return _swept(plan, state, bearing, step_m)
    if state.in_contact:
        size_n = math.hypot(state.force_x_n, state.force_y_n)
        ahead_x, ahead_y = -state.force_x_n / size_n, -state.force_y_n / size_n
        if s.mode == "steered":
            heading = steered(ahead_x, ahead_y, s.x1_m - state.believed.x_m, s.y1_m - state.believed.y_m)
            bearing = math.atan2(heading[1], heading[0])
        aside_rad = math.remainder(math.atan2(ahead_y, ahead_x) - bearing, 2.0 * math.pi)
        state = state._replace(aside_rad=aside_rad)
    return state, _beyond(state.place, bearing, step_m)


def _swept(plan: PushPlan, state: PushState, bearing: float, step_m: float) -> tuple[PushState, Place]:
    """Continue along a line across the push; at its end, change to the next line."""
    d = plan.distance_m
    along, across = state.line * plan.settings.pitch * d, (-1.0 if state.line % 2 else 1.0) * _HALF_LINE * d
    end = _beyond(_beyond(plan.start, bearing, along), bearing + 0.5 * math.pi, across)
    left = math.dist(end, state.place)
    if left <= step_m:
        return state._replace(line=state.line + 1), end
    return state, _beyond(state.place, math.atan2(end.y_m - state.place.y_m, end.x_m - state.place.x_m), step_m)


def _lines(plan: PushPlan) -> int:
    """Return the number of lines of a sweep; after the last one the particle lies d ahead, at its goal."""
    return math.ceil(plan.way_m / (plan.settings.pitch * plan.distance_m)) + 1


def _beyond(place: Place, bearing: float, way_m: float) -> Place:
    return Place(place.x_m + way_m * math.cos(bearing), place.y_m + way_m * math.sin(bearing))

"""A cell of a study: a law over a link against an environment, run in lockstep and judged.

A cell is plain data, so that it can be identified by a key, stored in a journal and sent to another machine. The hand
presses with a force that rises in steps and is then held: 1 N against the spring; 1 N, then 2 N in the contact (the
forces of Fig. 12). The last hold is judged.
"""

import functools
import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from telenano.analysis import STRUCK_FORCES as STRUCK_FORCES
from telenano.lockstep import Rig, Schedule, Trajectory
from telenano.numerics import source_digest
from telenano.sections import LAWS, SAMPLES, AfmConfig, ControllerConfig, HapticConfig, LimitsConfig
from telenano.settings import LinkSettings, Option, Settings, merge, nested, validate
from telenano.wire import ConfigError, RigError, known_names
from telenano_lab.studies import option_values
from telenano_lab.studies.loops.body import body_params
from telenano_lab.studies.loops.linear_loop import Hand as Hand
from telenano_lab.studies.loops.linear_loop import arm_of
from telenano_lab.studies.loops.links import Uneven, symmetric_link, uneven_schedule
from telenano_lab.studies.loops.theory import Series

ENVIRONMENTS = ("spring", "wall", "tip_sample", "body")
PACKAGE_SAMPLES = SAMPLES.all().found
if TYPE_CHECKING:
    Environment = str
else:
    # The environments include the samples of installed packages.
    Environment = Literal[(*ENVIRONMENTS, *PACKAGE_SAMPLES)]
# K of the theory's examples [N/m]; in the contact it is the cantilever's k of Table 2.
DEFAULT_STIFFNESS: dict[str, tuple[float, ...]] = {
    "spring": (10.0, 20.0, 38.0),
    "wall": (10.0, 38.0),
    "tip_sample": (40.0,),
    "body": (20.0,),
    **{name: (model.stiffness_n_per_m,) for name, model in PACKAGE_SAMPLES.items()},
}

_LEVELS_N: dict[str, tuple[float, ...]] = {
    **dict.fromkeys(DEFAULT_STIFFNESS, (1.0,)),
    "tip_sample": (1.0, 2.0),
}
# Wall and body only push; the tip meets them at this base position [m].
WALL_DISTANCE_M = 3e-9
# The cantilever of Table 2, which touches the body and through which environments without one are read [N/m].
CANTILEVER_N_PER_M = 40.0
# The base position at which a steady contact with the sample of Table 2 begins [m].
_CONTACT_M = 1.05e-8
# Further motion of the base for each newton at the hand [m/N].
_CONTACT_M_PER_N = 0.65e-9
# A study compares laws, whose swings grow until a device stops them: its hand has no ends within reach.
_WIDE = {"position_min_m": -1.0, "position_max_m": 1.0, "max_speed_m_per_s": 10.0}
# The time for which the hand rests before the first ramp [s].
_QUIET_S = 0.2
# The duration of a ramp of the hand's force to its next level [s].
_RAMP_S = 0.4
# The shortest duration of the approach [s].
_APPROACH_S = 2.4
# The approach is longer by this number of round trips. All times of a cell grow with the round trip, so that a slow
# loop gets the same number of its own periods.
_APPROACH_ROUND_TRIPS = 10.0
# The length of the hold [s]: near its onset, a limit cycle of the contact takes seconds to reach its size.
_HOLD_S: dict[str, float] = {**dict.fromkeys(DEFAULT_STIFFNESS, 6.0), "tip_sample": 12.0}
_HOLD_ROUND_TRIPS = 40.0
# The limits of every cell's instrument.
_LIMITS = AfmConfig().to_guard()
# A force at the hand that is smaller is no contact, and the ratio to it may be no number [N].
_PRESSED_N = 1e-12
# The first part of a hold, which is not judged, is the response to the step before it.
_TRANSIENT_SHARE = 0.2
_SHORTEST_HOLD_S = 1.0
# Facts of a hold that came to rest, but not as the hand meant it to.
WRONG_RESTS: tuple[str, ...] = ("nothing_moved", "off_force", "struck")


class Conditions(Settings):
    """Conditions shared by all cells of a study. `settings` are keys of `controller` that differ from the defaults."""

    environment: Environment = Field(
        description="spring: F = K (x_s - L); wall: the same, but only pushing, met from 3 nm; tip_sample: the"
        " force of Table 2; body: mass, damper and spring K, met from 3 nm by a cantilever of 40 N/m; or a sample of an"
        " installed package"
    )
    hand: Annotated[Hand, Option(("--hand", "--arm"))] = Field(
        default="force",
        description="force: a constant force regardless of the device's motion; else an arm of 50, 300 or 1000 N/m on "
        "its way along a path",
    )
    mass_kg: Annotated[float, Option(("--mass",), "KG")] = Field(
        default=0.01, gt=0.0, le=1e3, description="Mass of the body, at the tip [kg]; no other environment has one"
    )
    damping_n_s_per_m: Annotated[float, Option(("--body-damping",), "N*S/M")] = Field(
        default=0.02, ge=0.0, le=1e6, description="Damper of the body, at the tip [N s/m]"
    )
    device_latency_ms: Annotated[float, Option(("--device-latency",), "MS")] = Field(
        default=0.0,
        ge=0.0,
        le=1e3,
        description="Latency that real devices add to the round trip [ms]: the sum of device_latency_s in node/health",
    )
    seed: int = Field(default=0, ge=0, description="Seed of the link's random streams")
    session_s: Annotated[float | None, Option(("--duration",), "S")] = Field(
        default=None, gt=0.0, le=3600.0, description="Length of each session [s]; default: grows with the delay"
    )
    settings: Annotated[
        tuple[tuple[str, float | int | str | bool], ...],
        Option(("--set",), "LAW.KEY=VALUE", option_values.settings, many=True),
    ] = Field(default=(), description="Change a parameter of a law (SI units); may be repeated")
    disturbances: Annotated[
        tuple[tuple[str, float | int | str | bool], ...],
        Option(("--disturb",), "NAME|NAME.KEY=VALUE", option_values.disturbances, many=True),
    ] = Field(
        default=(),
        description="Switch on a disturbance of the instrument, or set a key of it, as in afm_node.disturbances"
        " (repeatable)",
    )


class Cell(Conditions):
    """The law, the link and the sample of one run."""

    law: str = Field(description="Name of the law")
    round_trip_ms: float = Field(ge=0.0, le=1e5, description="Round trip of the link [ms], half of it each way; >= 0")
    stiffness_n_per_m: float = Field(gt=0.0, le=1e6, description="K of the spring or k of the cantilever [N/m]; > 0")
    gain: float | None = Field(default=None, ge=0.0, description="Force gain K_f; none: the law's own")
    jitter_ms: float = Field(default=0.0, ge=0.0, le=1e5, description="Half-width of the uniform jitter each way [ms]")
    play_out: bool = Field(default=False, description="A play-out buffer at the end of each direction")
    loss: float = Field(default=0.0, ge=0.0, le=1.0, description="Share of messages lost each way; 0..1")
    burst: float | None = Field(
        default=None, ge=1.0, le=1e4, description="Mean number of messages lost in a row; none: each is lost by itself"
    )
    uneven: Uneven | None = Field(
        default=None, description="A link that is uneven in time both ways, instead of jitter and loss"
    )
    network: str | None = Field(
        default=None, description="A network of telenano/settings/networks both ways, instead of delay, jitter and loss"
    )
    uneven_ms: float = Field(default=30.0, gt=0.0, le=1e4, description="Its slots, outages, pauses or teeth [ms]")

    @property
    def key(self) -> str:
        """A digest of the cell and of all sources on which its outcome depends: a changed model gives another key."""
        text = self.model_dump_json() + sources()
        return hashlib.sha256(text.encode()).hexdigest()[:24]

    @property
    def has_random_link(self) -> bool:
        """Whether another seed of the link gives another session."""
        return self.jitter_ms > 0.0 or self.loss > 0.0 or self.network is not None

    @property
    def round_trip_s(self) -> float:
        """The round trip [s] with the latency of the devices, at the greatest jitter or unevenness."""
        widest_ms = self.uneven_ms if self.uneven else self.jitter_ms
        return (self.round_trip_ms + self.device_latency_ms + 2.0 * widest_ms) * 1e-3

    @property
    def felt_stiffness_n_per_m(self) -> float:
        """The greatest stiffness that the base can meet [N/m]; a body is met through its cantilever."""
        return CANTILEVER_N_PER_M if self.environment == "body" else self.stiffness_n_per_m

    def stiffness_doubts(self) -> str:
        """Return why the sample is too stiff for law and link, else ''; device latency counts as the instrument's."""
        even = not (self.has_random_link or self.uneven)
        return self.controller().stiffness_doubts(self.felt_stiffness_n_per_m, 1e-3 * self.device_latency_ms, even=even)

    def controller(self) -> ControllerConfig:
        """Return the configuration of both halves; ConfigError names the law or key at fault."""
        if self.law not in LAWS:
            raise ConfigError(f"--law: unknown law {self.law!r}, {known_names(self.law, LAWS)}")
        settings: dict[str, Any] = nested(dict(self.settings), "--set")
        if self.gain is not None:
            if "force_gain" not in LAWS[self.law].config.model_fields:
                names = ", ".join(name for name, law in LAWS.items() if "force_gain" in law.config.model_fields)
                raise ConfigError(f"--gain: {self.law} has no force gain; {names} has")
            settings = merge(settings, {self.law: {"force_gain": self.gain}})
        whole = merge({"hand_limits": _WIDE}, merge(settings, {"law": self.law}))
        return validate(ControllerConfig, whole, "--set", "controller")

    def hold_s(self) -> tuple[float, float]:
        """Return start and end of the judged hold in session time [s]; ConfigError if it is too short."""
        start = _QUIET_S + _RAMP_S * len(_LEVELS_N[self.environment])
        start += (_APPROACH_S + _APPROACH_ROUND_TRIPS * self.round_trip_s) * (len(_LEVELS_N[self.environment]) - 1)
        if self.session_s is None:
            return start, start + _HOLD_S[self.environment] + _HOLD_ROUND_TRIPS * self.round_trip_s
        if self.session_s - start < _SHORTEST_HOLD_S:
            raise ConfigError(
                f"--duration: {self.session_s:g} s leaves no hold of {_SHORTEST_HOLD_S:g} s at a round trip of "
                f"{self.round_trip_ms:g} ms: at least {start + _SHORTEST_HOLD_S:.2f} s are needed"
            )
        return start, self.session_s

    def hand_points(self) -> tuple[tuple[float, float], ...]:
        """Return the corners (time [s], force [N]) of the hand's programme."""
        levels = _LEVELS_N[self.environment]
        points, time, before = [], _QUIET_S, 0.0
        for level in levels:
            points += [(time, before), (time + _RAMP_S, level)]
            time += _RAMP_S + _APPROACH_S + _APPROACH_ROUND_TRIPS * self.round_trip_s
            before = level
        return tuple(points)

    def instrument(self) -> Any:
        """Return the constants of the environment and its guard; ConfigError for a body that cannot be simulated."""
        return _instrument(self.environment, self.stiffness_n_per_m, self.mass_kg, self.damping_n_s_per_m)

    def afm(self) -> AfmConfig:
        """Return the instrument that reads the force, with its disturbances; ConfigError names a wrong key."""
        # Link and instrument share one seed unless it is given.
        section = merge({"seed": self.seed}, nested(dict(self.disturbances), "--disturb"))
        return validate(AfmConfig, {"disturbances": section}, "--disturb")

    def disturbed_instrument(self, duration_s: float) -> Any:
        """Return the instrument with its disturbances for a run of duration_s [s]; ConfigError names a wrong key."""
        instrument = self.instrument()
        if not self.disturbances:
            return instrument
        config = self.afm()
        is_gauged = self.environment != "tip_sample"
        cantilever = _instrument("tip_sample", CANTILEVER_N_PER_M, 1.0, 0.0).plant if is_gauged else instrument.plant
        noisy = config.with_noise(instrument.plant, cantilever, duration_s, is_gauged=is_gauged)
        return instrument._replace(plant=noisy)

    def operator(self, points: Sequence[tuple[float, float]]) -> dict[str, Any]:
        """Return the section `haptic_node.operator` for a programme: corners (time [s], force [N]).

        The path of an arm leads to where it would press with that force if hand and sample were one.
        """
        arm = arm_of(self.hand)
        if arm is None:
            return {"kind": "force_profile", "points": [{"time_s": time, "force_n": force} for time, force in points]}
        scales = scales_of(self.controller())
        first_m, per_newton_m = 0.0, 1.0 / (scales.force_scale * self.stiffness_n_per_m)
        if self.environment in ("wall", "body"):
            first_m = WALL_DISTANCE_M
        if self.environment == "body":
            per_newton_m += 1.0 / (scales.force_scale * CANTILEVER_N_PER_M)
        if self.environment == "tip_sample":
            first_m, per_newton_m = _CONTACT_M, _CONTACT_M_PER_N
        if self.environment in PACKAGE_SAMPLES:
            first_m = getattr(PACKAGE_SAMPLES[self.environment].config(), "rest_distance_m", 0.0)
        arm_m_per_n = 1.0 / arm.stiffness_n_per_m
        path = []
        for time, force in points:
            tip_m = first_m + force * per_newton_m if force > 0.0 else 0.0
            path.append({"time_s": time, "position_m": tip_m / scales.position_scale + force * arm_m_per_n})
        return {"kind": "impedance", "arm": self.hand, "path": path}


@dataclass(frozen=True)
class CellResult:
    """The outcome of a cell.

    verdict: see `telenano.analysis.verdict`. reason: the reason for the outcome, in words. growth_per_s: [1/s] or None.
    peak_to_peak_n: of alpha_f F_s at the end of the hold [N]. out_of_contact_share: the share of the judged hold in
    which the tip was off the surface. hold_ratio: the mean of F_m / (alpha_f F_s), None if the tip was not pressed.
    lowest_energy_j: the least value of the energy that the hand had put into the two-port, at its device, minus the
    energy given to the tip, at the hand's scale [J]; below zero two-port and device have generated energy. guarded:
    whether the instrument's safety chain ended the session. peak_n: the greatest alpha_f F_s of the session [N], None
    if it never began. Means over the later half of the hold: tip_n, alpha_f F_s [N]; hand_n, F_m [N]; apart_m, the lead
    of the hand over the tip, x_m - x_s / alpha_p [m]. hand_work_j: the work of the hand [J]. guarded_share: the share
    of the session in which a guard had taken over: the instrument did not follow, or the motor was off. facts: further
    facts of the hold, by `telenano.analysis.holds.FactKind`.
    """

    cell: Cell
    verdict: str
    growth_per_s: float | None
    peak_to_peak_n: float
    out_of_contact_share: float
    hold_ratio: float | None
    lowest_energy_j: float
    guarded: bool
    reason: str = ""
    peak_n: float | None = None
    tip_n: float | None = None
    hand_n: float | None = None
    apart_m: float | None = None
    hand_work_j: float | None = None
    guarded_share: float | None = None
    facts: tuple[str, ...] = ()

    @property
    def outcome(self) -> str:
        """The verdict; for a cell that came to rest wrongly, the fact that says how."""
        wrong = next((fact for fact in self.facts if fact in WRONG_RESTS), "stable")
        return wrong if self.verdict == "stable" else self.verdict

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain data; `from_dict` is the inverse."""
        return {**asdict(self), "cell": self.cell.model_dump(mode="json")}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "CellResult":
        own = {"cell": Cell.model_validate_json(json.dumps(data["cell"])), "facts": tuple(data.get("facts", ()))}
        return cls(**{**data, **own})


class _Judgement(NamedTuple):
    """The judgement on a hold: verdict, growth [1/s], force from peak to peak [N], reason, and facts."""

    verdict: str
    growth_per_s: float | None
    peak_to_peak_n: float
    reason: str
    facts: tuple[str, ...]


# The judgement without a hold: the hand does not press and the tip does not touch, and the law is not the cause.
_UNTOUCHED = _Judgement("stable", None, 0.0, "the hand does not press, and the tip does not touch", ("nothing_moved",))


class Energies(NamedTuple):
    """Energies at the hand's scale: put in by the hand [J], and given to the tip [J], shape (n,) each."""

    hand_j: Series
    tip_j: Series

    @property
    def stored_j(self) -> Series:
        """The energy stored in the two-port [J]; below zero it has generated energy."""
        return np.subtract(self.hand_j, self.tip_j)


def run_cell(cell: Cell, run: Callable[[], Trajectory] | None = None) -> CellResult:
    """Run and judge a cell; a cell whose tip was never placed is guarded.

    Args:
        cell: The cell.
        run: Returns its course; None takes `trajectory_of`.

    Raises:
        ConfigError: The cell cannot be run.
    """
    try:
        course = trajectory_of(cell) if run is None else run()
    except RigError as error:
        return never_placed(cell, error)
    return judged(cell, course)


def never_placed(cell: Cell, error: RigError) -> CellResult:
    """Return the result of a cell whose session never began, because a stall of the link made the guard withdraw."""
    return CellResult(cell, "guarded", None, 0.0, 1.0, None, 0.0, True, str(error))


def trajectory_of(cell: Cell) -> Trajectory:
    """Return the course of a cell's whole session; RigError if the tip was never placed."""
    return course_of(cell, cell.hand_points(), cell.hold_s()[1])


def course_of(
    cell: Cell,
    hand_points: Sequence[tuple[float, float]],
    end_s: float,
    measured: tuple[LinkSettings, Path] | None = None,
) -> Trajectory:
    """Return the course of a cell with another programme of the hand.

    Args:
        cell: The cell.
        hand_points: The corners of the hand's programme: time [s], force [N].
        end_s: The length of the programme [s].
        measured: The settings of a measured link instead of the cell's own, with the folder of their files.
    """
    rig = rig_of(cell, hand_points, settle_s(cell) + end_s)
    settle = settle_ticks(cell, rig.period_s)
    ticks = settle + max(1, round(end_s / rig.period_s))
    if measured is not None:
        settings, folder = measured
        schedule = Schedule.of(settings, ticks, rig.period_s, folder, play_out=cell.play_out)
    elif cell.uneven is not None:
        round_trip_s = (cell.round_trip_ms + cell.device_latency_ms) * 1e-3
        schedule = uneven_schedule(round_trip_s, cell.uneven, 1e-3 * cell.uneven_ms, ticks, rig.period_s)
    elif cell.network is not None:
        schedule = _network_schedule(cell.network, cell.seed, ticks, rig.period_s, play_out=cell.play_out)
    else:
        # The position of a constant delay in the loop makes no difference.
        delay_s = (cell.round_trip_ms + cell.device_latency_ms) * 1e-3
        jitter_s = cell.jitter_ms * 1e-3
        link = (delay_s, jitter_s, cell.loss, cell.seed, cell.burst)
        schedule = _schedule(link, ticks, rig.period_s, play_out=cell.play_out)
    return rig.run(schedule, settle)


def settle_s(cell: Cell) -> float:
    """Return the time before the session [s] in which the instrument is armed and moves to its reference."""
    return AfmConfig().time_to_place_s(cell.round_trip_s)


def settle_ticks(cell: Cell, period_s: float) -> int:
    """Return `settle_s` in whole ticks."""
    return math.ceil(settle_s(cell) / period_s)


@functools.lru_cache(maxsize=16)
def _schedule(
    link: tuple[float, float, float, int, float | None], ticks: int, period_s: float, *, play_out: bool
) -> Schedule:
    """Return the arrivals over a link; cached, because laws and hands share it, and drawing a random one is slow."""
    return Schedule.of(symmetric_link(*link), ticks, period_s, play_out=play_out)


@functools.lru_cache(maxsize=16)
def _network_schedule(network: str, seed: int, ticks: int, period_s: float, *, play_out: bool) -> Schedule:
    """Return the arrivals over a named network, with the draws of a seed; cached as `_schedule`."""
    return Schedule.of(LinkSettings.of({"profile": network, "seed": seed}), ticks, period_s, play_out=play_out)


def judged(cell: Cell, course: Trajectory) -> CellResult:
    """Return the result of a session of a cell: the verdict with its figures."""
    controller = cell.controller()
    scales = scales_of(controller)
    start_s, end_s = cell.hold_s()
    # A pause in the commands makes the instrument hold for a moment; only a retraction ends the session.
    lost = ~(course.follows | course.held)
    ended = int(np.argmax(lost)) if lost.any() else len(lost)
    force = scales.force_scale * course.tip_force_n
    deadlines_s = (_LIMITS.command_deadline_s, LimitsConfig().command_deadline_s)
    late = course.hand_force_n[int(np.searchsorted(course.time_s, 0.5 * (start_s + end_s))) : ended]
    span = (start_s, end_s, float(late.mean()) if late.size else _LEVELS_N[cell.environment][-1])
    knows_contact = cell.environment == "tip_sample"
    transit_s = cell.round_trip_s + controller.period_s
    holds = course.holds(controller, transit_s, deadlines_s, (span,), knows_contact=knows_contact, afm=cell.afm())
    judgement = _UNTOUCHED
    if holds:
        (found,) = holds
        facts = tuple(fact.kind for fact in found.facts)
        wrong = next((fact for fact in found.facts if fact.kind in WRONG_RESTS), None)
        # If a hold rests wrongly, that is the reason; the reason of the verdict would only say why it rests.
        reason = wrong.text if wrong is not None and found.verdict == "stable" else found.reason
        judgement = _Judgement(found.verdict, found.growth_per_s, found.peak_to_peak_n, reason, facts)
    first = int(np.searchsorted(course.time_s, start_s + _TRANSIENT_SHARE * (end_s - start_s)))
    if ended < len(lost):
        # A run that a guard ended early is judged from the beginning of the hold.
        first = int(np.searchsorted(course.time_s, start_s))
    hold = slice(min(first, ended), ended)
    later = slice((hold.start + hold.stop) // 2, hold.stop)
    peak_n = float(force[:ended].max(initial=0.0))
    return CellResult(
        cell,
        judgement.verdict,
        judgement.growth_per_s,
        judgement.peak_to_peak_n,
        1.0 - float(course.in_contact[hold].mean()) if ended > first else 1.0,
        hold_ratio(course.hand_force_n[hold], force[hold]),
        float(energies_of(course, scales).stored_j.min()),
        ended < len(lost),
        judgement.reason,
        peak_n,
        *_held(course, scales, later),
        float(course.hand_energy_j[-1] - course.hand_energy_j[0]),
        float(np.mean(~course.follows | ~course.hand_following)),
        judgement.facts,
    )


def hold_ratio(hand_n: Series, force_n: Series) -> float | None:
    """Return the mean ratio of the forces of hand and scaled tip [N], shapes (n,); None out of contact."""
    pressed = force_n > _PRESSED_N
    return float(np.mean(hand_n / force_n)) if pressed.size and pressed.all() else None


def _held(course: Trajectory, scales: "Scales", part: slice) -> tuple[float | None, float | None, float | None]:
    """Return the means of alpha_f F_s [N], F_m [N] and x_m - x_s / alpha_p [m] over a part of the session."""
    if part.stop <= part.start:
        return None, None, None
    apart = course.hand_position_m[part] - course.base_position_m[part] / scales.position_scale
    tip_n = scales.force_scale * float(course.tip_force_n[part].mean())
    return tip_n, float(course.hand_force_n[part].mean()), float(apart.mean())


class Scales(NamedTuple):
    """alpha_f and alpha_p of a law."""

    force_scale: float
    position_scale: float


def scales_of(controller: ControllerConfig) -> Scales:
    """Return the scales of the law in force."""
    section = controller.law_config()
    return Scales(section.force_scale, section.position_scale)


def energies_of(course: Trajectory, scales: Scales) -> Energies:
    """Return the energy through the two ports of the law since the session began, by the trapezoidal rule.

    The hand's port has F_m and the position x_m of the device, so it includes the device's servo; the tip's port has
    F_s and the base x_s.
    """
    to_hand = scales.force_scale / scales.position_scale
    tip_j = to_hand * _work(course.tip_force_n, course.base_position_m)
    return Energies(_work(course.hand_force_n, course.hand_position_m), tip_j)


def _work(force_n: Series, position_m: Series) -> Series:
    mean = 0.5 * (force_n[1:] + force_n[:-1])
    return np.concatenate([[0.0], np.cumsum(mean * np.diff(position_m))])


@functools.lru_cache(maxsize=64)
def _instrument(environment: Environment, stiffness_n_per_m: float, mass_kg: float, damping_n_s_per_m: float) -> Any:
    if environment == "tip_sample":
        return AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": stiffness_n_per_m}}).to_params()
    # The spring also pulls, so the session begins at its rest position, not at a retracted base.
    section: dict[str, Any] = {"environment": environment, "safety": {"retract_position_m": 0.0}}
    if environment in PACKAGE_SAMPLES:
        section[environment] = sample_config(environment, stiffness_n_per_m)
        return AfmConfig.model_validate(section).to_sample_params()
    rest_m = 0.0 if environment == "spring" else WALL_DISTANCE_M
    spring = {"stiffness_n_per_m": stiffness_n_per_m, "rest_position_m": rest_m, "bilateral": environment == "spring"}
    instrument = AfmConfig.model_validate({**section, "environment": "spring", "spring": spring}).to_spring_params()
    if environment != "body":
        return instrument
    try:
        body = body_params(stiffness_n_per_m, damping_n_s_per_m, mass_kg, CANTILEVER_N_PER_M, WALL_DISTANCE_M)
    except ValueError as error:
        raise ConfigError(f"--mass: {error}") from error
    return instrument._replace(plant=body)


def sample_config(environment: str, stiffness_n_per_m: float) -> Any:
    """Return the settings of a package's sample, with a stiffness [N/m] if they have one."""
    config = PACKAGE_SAMPLES[environment].config
    settings = {"stiffness_n_per_m": stiffness_n_per_m} if "stiffness_n_per_m" in config.model_fields else {}
    return validate(config, settings, "--stiffness", environment)


def rig_of(cell: Cell, hand_points: Sequence[tuple[float, float]], duration_s: float = 0.0) -> Rig:
    """Return the rig of a cell with its hand.

    Args:
        cell: The cell.
        hand_points: The corners of the hand's programme: time [s], force [N].
        duration_s: The length of the run [s], for which the disturbances are drawn.

    Raises:
        ConfigError: The rig cannot be built.
    """
    haptic = validate(HapticConfig, {"operator": cell.operator(hand_points)}, "--hand", "haptic_node")
    return Rig.of(cell.controller(), haptic, cell.disturbed_instrument(duration_s))


@functools.lru_cache(maxsize=1)
def sources() -> str:
    """Return a digest of all sources on which the outcome of a cell depends."""
    own = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    return source_digest() + hashlib.sha256(own).hexdigest()

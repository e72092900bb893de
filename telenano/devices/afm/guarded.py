"""An instrument behind its guard, with the parts around both: it makes one step, for a command or for a program.

A part adds a feature that an instrument may have or lack, such as a lateral stage or a recorded map (`device_node`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import msgspec

from telenano.afm import safety
from telenano.afm.felt import LEFT, FeltInputs, FeltState, felt_step
from telenano.afm.layers import Layer
from telenano.afm.programs.runner import ProgramRunner
from telenano.extend.instruments import AfmDriver, AfmReport, LateralStage, OwnScan, SafetyParams, Simulation
from telenano.extend.programs import FinishedLine, Inputs, Wanted
from telenano.extend.samples import AfmSample, Oscillation
from telenano.extend.stage import LATERAL_BY_RANGE, LATERAL_BY_SPEED, LateralParams, Place, moved
from telenano.runtime.loop.device_node import DeviceNode, Parts, StepPart
from telenano.runtime.loop.node import Node
from telenano.sections.afm_parts import FrictionConfig
from telenano.sections.afm_section import AfmConfig
from telenano.sections.feel_section import FeelConfig
from telenano.sections.sample_section import layers_on
from telenano.timing.clock import NEVER_NS
from telenano.wire.messages import AfmCommand, Array

# A warning at the edge of a map is repeated only after this time away from the edge: a hand may tremble there.
_QUIET_NS = 2_000_000_000
# The truth of a layer is examined every 50 ms, and published while it changes.
_LOOK_PERIOD_NS = 50_000_000
# While it does not change, only every twentieth is published.
_RESTING_LOOKS = 20
Event = Callable[[str, str, str], None]


class AfmMemory(msgspec.Struct, array_like=True):
    """The memory of an instrument from step to step.

    guard: state of the guard. command: newest command; followed: newest command whose hand was armed, which is in
    force, received at followed_received_ns [ns]. force_n, lateral_n: forces on the tip at the last step [N]. place:
    place of the tip; pointer: place where a person wants it. told_ns, stepped_ns, due_ns: times of the last report of a
    program, of the last step and of the next one [ns]. felt: state of the felt channel, None if the force is felt.
    particles_look: number of the last look at the layers of the sample, under the name of earlier recordings. placed:
    whether the tip was placed at the last step; places: whether that has still to be reported after arming. disarmed:
    whether the hand was disarmed while the tip was held, after which no command ends the hold. interrupted: whether
    another command has come since the last step. words: whether an `arm` has to state where the tip may go, which it
    did not in earlier recordings. found_m: position of the base at the last step by its read-out [m]; away: whether the
    device was lost at that step, or has not been seen yet.
    """

    guard: safety.SafetyState
    command: AfmCommand | None = None
    followed: AfmCommand | None = None
    followed_received_ns: int = 0
    force_n: float = 0.0
    lateral_n: tuple[float, float] = (0.0, 0.0)
    place: Place = Place(0.0, 0.0)
    pointer: Place = Place(0.0, 0.0)
    told_ns: int = 0
    stepped_ns: int = 0
    due_ns: int = 0
    felt: FeltState | None = None
    particles_look: int = 0
    placed: bool = False
    places: bool = False
    disarmed: bool = False
    interrupted: bool = False
    words: bool = False
    found_m: float = 0.0
    away: bool = False

    def asks(
        self, base_m: float, action: int, command_age_s: float, *now: bool, by_hand: tuple[Any, ...] = ()
    ) -> safety.SafetyInputs:
        """Return the inputs of the guard.

        Args:
            base_m: The reference [m].
            action: The action of the command (ACTION_*).
            command_age_s: The age of the command [s].
            now: Three flags: whether to arm, whether to stop, and whether the device is lost.
            by_hand: The inputs from `of_hand` on, if the reference is that of a hand.
        """
        arm, estop, is_lost = now
        across_n = math.hypot(*self.lateral_n)
        return safety.SafetyInputs(base_m, command_age_s, action, arm, estop, self.force_n, is_lost, across_n, *by_hand)


@dataclass(slots=True)
class Step:
    """One step: inputs and output of the guard, wanted position, length [s], measured sample, inputs of a program.

    added_fields: keys of afm/state that the parts add. stage_limited: bits LATERAL_BY_* of the stage.
    """

    asked: safety.SafetyInputs
    allowed: safety.SafetyOutputs
    wanted: Wanted[Any]
    elapsed_s: float
    sample: AfmSample = field(init=False)
    inputs: Inputs = field(init=False)
    added_fields: dict[str, Any] = field(default_factory=dict)
    stage_limited: int = 0

    @property
    def limited_by(self) -> str | None:
        """The limit that is acting on the base or the stage, the most lasting one of several; None if none is."""
        base, stage = self.allowed.limited, self.stage_limited
        acting = (
            (base & safety.LIMITED_BY_RANGE, "range"),
            (stage & LATERAL_BY_RANGE, "area"),
            (base & safety.LIMITED_BY_SPEED, "speed"),
            (stage & LATERAL_BY_SPEED, "lateral_speed"),
        )
        return next((name for is_acting, name in acting if is_acting), None)

    @property
    def follows(self) -> bool:
        return self.allowed.mode == safety.MODE_FOLLOW

    def fields(self, memory: AfmMemory) -> dict[str, Any]:
        """Return the fields of afm/state, without those of the command."""
        sample = self.sample
        return {
            "base_position_m": (*memory.place, 0.0 - sample.base_m),
            "deflection_m": sample.deflection_m,
            "tip_force_n": (*memory.lateral_n, sample.force_n),
            "separation_m": sample.distance_m,
            "separation_valid": sample.distance_valid,
            "in_contact": sample.in_contact,
            "meniscus": sample.meniscus,
            "mode": safety.MODE_NAMES[self.allowed.mode],
            "limited": self.allowed.limited != 0,
            "armed": safety.is_armed(self.allowed.mode, self.allowed.reason),
            "placed": memory.placed,
            "step_s": self.elapsed_s,
            **({} if self.limited_by is None else {"limited_by": self.limited_by}),
            **self.added_fields,
        }


def line_fields(line: FinishedLine, lines: int, friction: FrictionConfig) -> dict[str, Any]:
    """Return the fields of afm/scanline for a line of an image with `lines` lines."""
    further = {"dissipated_j": line.dissipated_j, "lateral_force_n": line.lateral_n}
    if line.lateral_n is not None:
        further["torsion_rad"] = line.lateral_n / (friction.lateral_stiffness_n_per_m * friction.tip_height_m)
    return {
        "line": line.line,
        "lines": lines,
        "direction": "retrace" if line.backward else "trace",
        "start_m": (*line.start, 0.0),
        "end_m": (*line.end, 0.0),
        "height_m": Array.from_numpy(line.height_m),
        "amplitude_m": None if line.amplitude_m is None else Array.from_numpy(line.amplitude_m),
        "phase_rad": None if line.phase_rad is None else Array.from_numpy(line.phase_rad),
        **{key: Array.from_numpy(array) for key, array in further.items() if array is not None},
    }


AfmPart = StepPart[Step, AfmMemory]


class MapEdge(AfmPart):
    """Keeps the tip on a recorded map in x and y, and warns once when it was asked to go beyond."""

    def __init__(self, places_m: tuple[float, float], event: Event) -> None:
        self._places_m, self._event = places_m, event
        self._quiet_until_ns = 0

    def prepare(self, step: Step, memory: AfmMemory) -> None:
        wanted, allowed = step.wanted.place, step.allowed
        place = Place(*(min(max(at, -most), most) for at, most in zip(wanted, self._places_m, strict=True)))
        if place == wanted and not (allowed.limited & safety.LIMITED_BY_RANGE and step.follows):
            return
        is_quiet = not step.follows or memory.stepped_ns < self._quiet_until_ns
        self._quiet_until_ns = memory.stepped_ns + _QUIET_NS
        if place != wanted and step.follows:
            step.stage_limited |= LATERAL_BY_RANGE
        step.wanted = step.wanted._replace(place=place)
        if not is_quiet:
            at = f"x = {wanted.x_m:.4g} m, y = {wanted.y_m:.4g} m"
            asked = f"a base beyond {allowed.base_m:.4g} m" if place == wanted else at
            text = f"the recorded map ends here, and the tip stays on it: it was asked to go to {asked}"
            self._event("mode", "warning", text)


class Stage(AfmPart):
    """Moves the tip over the sample, and measures the force across it."""

    def __init__(self, stage: LateralStage, params: LateralParams) -> None:
        self._stage, self._params = stage, params

    def prepare(self, step: Step, memory: AfmMemory) -> None:
        if step.follows and step.wanted.place != memory.place:
            memory.place, limited = moved(self._params, memory.place, step.wanted.place, step.elapsed_s)
            step.stage_limited |= limited
            self._stage.move_to(*memory.place)

    def measure(self, step: Step, memory: AfmMemory) -> None:
        memory.lateral_n = self._stage.lateral_force_n


class SimulatedTime(AfmPart):
    """Advances the time of a simulation.

    Between two steps it simulates the known part of the motion, in shares between which other tasks can run.
    """

    def __init__(self, simulation: Simulation, node: Node) -> None:
        self._simulation, self._node = simulation, node

    def prepare(self, step: Step, memory: AfmMemory) -> None:
        self._simulation.elapse(step.elapsed_s)

    def report(self, step: Step, memory: AfmMemory) -> None:
        if self._simulation.settles:
            self._node.defer(self._settle, NEVER_NS)

    def _settle(self) -> None:
        if self._simulation.settle():
            self._node.defer(self._settle, NEVER_NS)


class Truths(AfmPart):
    """Publishes the truths of the layers on the sample, for recordings (`telenano.afm.layers`)."""

    def __init__(self, layers: Sequence[Layer], simulation: Simulation, node: Node) -> None:
        self._layers, self._simulation, self._node = layers, simulation, node

    def report(self, step: Step, memory: AfmMemory) -> None:
        look, before = memory.stepped_ns // _LOOK_PERIOD_NS, memory.particles_look
        if look == before:
            return
        memory.particles_look = look
        rests, truths = look // _RESTING_LOOKS != before // _RESTING_LOOKS, self._simulation.truths
        for layer in self._layers:
            if rests or layer.changes(truths[layer.name]):
                self._node.publish(layer.topic, **layer.fields(truths[layer.name]))


class OwnImages(AfmPart):
    """Lets an instrument take an image by its own scan while the guard is in FOLLOW, and ends the scan otherwise."""

    def __init__(self, own_scan: OwnScan) -> None:
        self._own_scan = own_scan

    def prepare(self, step: Step, memory: AfmMemory) -> None:
        self._own_scan.want_image(step.wanted.image if step.follows else None)


class RealDevice(AfmPart):
    """Handles the reports of a real instrument."""

    def __init__(self, driver: AfmDriver, node: DeviceNode) -> None:
        self._driver, self._node = driver, node

    def measure(self, step: Step, memory: AfmMemory) -> None:
        self._report = report = cast(AfmReport, self._driver.report)
        if not report.force_valid:
            # NaN makes the guard retract the tip: the force is beyond the range of the input.
            memory.force_n = math.nan
        step.added_fields.update(
            device=report.status, sample_age_s=report.age_s, output_v=report.output_v, input_v=report.input_v
        )

    def report(self, step: Step, memory: AfmMemory) -> None:
        self._node.process_report(self._report)


class Feel(AfmPart):
    """Computes the force that is felt from a measured channel (`felt`).

    The guard judges the greater of felt and measured force; it gets NaN when the value has left the branch.
    """

    def __init__(self, feel: FeelConfig, driver: AfmDriver, event: Event) -> None:
        self._channel, self._params = feel.channel, feel.to_params()
        self._driver, self._event = driver, event
        self._left = False

    def measure(self, step: Step, memory: AfmMemory) -> None:
        value = getattr(self._driver, "channels", {}).get(self._channel, math.nan)
        inputs = FeltInputs(value, step.sample.base_m, memory.place, step.allowed.mode == safety.MODE_RETRACTED)
        memory.felt, felt = felt_step(self._params, memory.felt or FeltState(), inputs, step.elapsed_s)
        left = felt.clamp == LEFT
        memory.force_n = math.nan if left else max(memory.force_n, felt.force_n)
        if left and not self._left:
            text = f"{self._channel} = {value:.6g} has left the branch of feel.table: the tip retracts"
            self._event("fault", "warning", text)
        self._left = left
        step.added_fields.update(felt_channel=self._channel, felt_clamp=felt.clamp)
        if math.isfinite(value):
            step.added_fields["felt_value"] = value
        step.sample = step.sample._replace(force_n=felt.force_n)


def parts_of(node: DeviceNode, config: AfmConfig, driver: AfmDriver) -> list[AfmPart]:
    """Return the parts of an instrument whose driver is open, in the order in which they act."""
    parts: list[AfmPart] = []
    if config.map_span is not None:
        parts.append(MapEdge(config.places_m, node.event))
    if driver.stage is not None:
        parts.append(Stage(driver.stage, config.to_lateral_params()))
    if driver.simulation is not None:
        parts.append(SimulatedTime(driver.simulation, node))
        layers = [layer for layer, _ in layers_on(config.sample) if layer.topic]
        parts.append(Truths(layers, driver.simulation, node))
    if (own_scan := getattr(driver, "own_scan", None)) is not None:
        parts.append(OwnImages(own_scan))
    if driver.report is not None:
        parts.append(RealDevice(driver, node))
    if config.feel is not None:
        parts.append(Feel(config.feel, driver, node.event))
    return parts


class _Still:
    """The drive of an instrument that cannot vibrate its base: it does nothing."""

    oscillation = Oscillation(0.0, 0.0)

    def vibrate(self, amplitude_m: float) -> None: ...


class GuardedInstrument:
    """A driver behind a guard with the given limits, and the parts around both."""

    def __init__(self, limits: SafetyParams, driver: AfmDriver, parts: Sequence[AfmPart]) -> None:
        self._limits, self._driver = limits, driver
        self._vibration = driver.vibration or _Still()
        own_scan = getattr(driver, "own_scan", None)
        self._own_line = (lambda: None) if own_scan is None else own_scan.take_line
        self.parts = Parts(parts)

    def step(self, memory: AfmMemory, asked: safety.SafetyInputs, wanted: Wanted[Any], elapsed_s: float) -> Step:
        """Pass the inputs through the guard, apply the base that it allows, and measure."""
        self._find(memory, asked.device_lost)
        followed = memory.guard.mode in (safety.MODE_FOLLOW, safety.MODE_HOLD)
        memory.guard, allowed = safety.safety_step(self._limits, memory.guard, asked, elapsed_s)
        if followed and allowed.mode not in (safety.MODE_FOLLOW, safety.MODE_HOLD) and self._driver.report is not None:
            # A slow instrument must not go on, after it was made safe, to where the guard had let it go before.
            memory.guard = safety.found_at(memory.guard, memory.found_m)
            allowed = allowed._replace(base_m=memory.guard.base_m)
        step = Step(asked, allowed, wanted, elapsed_s)
        self.parts.prepare(step, memory)
        # A tapping tip vibrates until it is retracted: at rest it would lie on the sample, and push particles aside.
        if not step.follows and allowed.base_m <= self._limits.retract_position_m:
            self._vibration.vibrate(0.0)
        # Until a fresh reading tells where the base of a device that comes back is, it is asked for no other place.
        safe_m = self._driver.safe_position_m if memory.away else allowed.base_m
        step.sample = self._driver.exchange(min(allowed.base_m, safe_m))
        memory.force_n, memory.found_m = step.sample.force_n, step.sample.base_m
        self.parts.measure(step, memory)
        return step

    def _find(self, memory: AfmMemory, is_lost: bool) -> None:
        """Let the base of a device that has come back be where its first fresh reading finds it."""
        report = self._driver.report
        if is_lost:
            memory.away = True
        elif memory.away and (report is None or report.status == "ok"):
            # Its driver has just sent it to its place of safety, and a slow reading may still show the way there.
            found_m = min(memory.found_m, self._driver.safe_position_m)
            memory.guard, memory.away = safety.found_at(memory.guard, found_m), False

    def step_program(
        self, memory: AfmMemory, programs: ProgramRunner, elapsed_s: float, estop: bool = False, lost: bool = False
    ) -> Step:
        """Make a step of the running program; `estop`: the stop is pressed, `lost`: the device is lost."""
        mode, base_m = memory.guard.mode, memory.guard.base_m
        felt, moving = (memory.force_n, memory.lateral_n), self._vibration.oscillation
        inputs = Inputs(base_m, memory.place, *felt, moving, memory.pointer, own=self._own_line())
        action, wanted = programs.step(inputs, elapsed_s)
        if action == safety.ACTION_POSITION:
            self._vibration.vibrate(wanted.amplitude_m)
        arm = mode == safety.MODE_RETRACTED and action == safety.ACTION_POSITION
        # The reference of the program is made in this step, so its age is 0.
        step = self.step(memory, memory.asks(wanted.base_m, action, 0.0, arm, estop, lost), wanted, elapsed_s)
        step.inputs = inputs
        programs.follow_guard(step.allowed.mode, step.allowed.reason)
        return step

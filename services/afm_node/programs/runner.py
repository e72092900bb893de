"""Programs of the instrument: it moves its tip by itself, behind the guard, until all is done or something ends it."""

from typing import Literal, NamedTuple

from proto.errors import RefusedError
from services.afm_node import safety
from services.afm_node.programs import approach, raster, tactile
from services.afm_node.programs.lateral import LateralParams, Place
from services.afm_node.programs.raster import FinishedLine, Measured
from services.afm_node.programs.reach import Reach, approach_limit_s
from services.afm_node.programs.scan_speed import felt_speed_m_per_s
from services.afm_node.programs.settings import CurveSettings, InstrumentRequest, ScanSettings, TactileSettings

ProgramState = Literal["running", "paused", "finished", "ended"]
# of the guard, where a program may not begin, and why
_NOT_READY = {
    safety.MODE_RETRACTING: "the tip is still retracting",
    safety.MODE_ESTOP: "the emergency stop is latched: arm the AFM first",
}


class Wanted(NamedTuple):
    """What a program asks of the guard and the stage; amplitude_m, of the vibration without a sample [m]."""

    action: int
    reference_m: float
    place: Place
    amplitude_m: float = 0.0


class Report(NamedTuple):
    """What is reported of a program: `afm/program`."""

    program: str
    state: ProgramState
    text: str
    done_percent: float
    line: int
    lines: int


class ProgramRunner:
    """Runs one program at a time; its state is plain values, for the journal of the node.

    Parameters: limits of the guard and of the stage, None where there is none; size_m, sides of the sample [m];
    stiffness_n_per_m, of the cantilever; period_s, of the node; can_vibrate, the base can be driven; lag, what
    is left of a change of the amplitude after a period; reach, of the base over a surface whose heights are known,
    None for an instrument that has to find the surface.
    """

    def __init__(
        self,
        limits: safety.SafetyParams,
        lateral: LateralParams | None,
        size_m: tuple[float, float],
        stiffness_n_per_m: float,
        period_s: float,
        *,
        can_vibrate: bool = False,
        lag: float = 0.0,
        reach: Reach | None = None,
    ) -> None:
        self.name = ""
        self.state: ProgramState = "finished"
        self._limits, self._lateral = limits, lateral
        self._size_m, self._stiffness, self._period_s = size_m, stiffness_n_per_m, period_s
        self._can_vibrate, self._free_amplitude_m = can_vibrate, 0.0
        self._lag = lag
        self._reach = reach
        self._raster: tuple[raster.RasterPlan, raster.RasterState] | None = None
        self._curve: tuple[approach.CurvePlan, approach.CurveState] | None = None
        self._tactile: tuple[tactile.TactilePlan, tactile.TactileState] | None = None
        self._aborted = ""
        self._was_limited, self._notice = False, ""

    def request(self, request: InstrumentRequest, mode: int, place: Place, *, device_lost: bool) -> str:
        """Begin a program, or change the one that runs; return a sentence. RefusedError says why not.

        Parameters: place, where the tip is.
        """
        if request.program in ("scan", "curve", "tactile"):
            if self.name:
                raise RefusedError(f"program: a {self.name} is running; abort it first")
            if reason := "the instrument is lost" if device_lost else _NOT_READY.get(mode, ""):
                raise RefusedError(f"program: {reason}")
            if request.program == "scan":
                return self._begin_scan(request.scan, place)
            if request.program == "tactile":
                return self._begin_tactile(request.tactile, place)
            return self._begin_curve(request.curve, place)
        if not self.name:
            raise RefusedError(f"program: there is none to {request.program}")
        if request.program == "abort":
            return self.abort()
        if self._raster is None:
            raise RefusedError(f"program: a {self.name} cannot {request.program}, it can be aborted")
        self.state = "paused" if request.program == "pause" else "running"
        return f"the {self.name} is {self.state}"

    def abort(self) -> str:
        """End the program that runs, with the tip retracted; return a sentence."""
        self._aborted = "it was aborted"
        return f"the {self._label} ends and the tip retracts"

    def _begin_scan(self, settings: ScanSettings, place: Place) -> str:
        if self._lateral is None:
            raise RefusedError("program: scan needs a lateral stage, which this instrument has none of")
        s = settings
        if s.mode == "tapping" and not self._can_vibrate:
            raise RefusedError("scan.mode: tapping needs a cantilever that vibrates: afm_node.model dynamic")
        free_m = s.amplitude_m if s.mode == "tapping" else 0.0
        width_m = self._size_m[0] if s.width_m is None else s.width_m
        depth_m = self._size_m[1] if s.depth_m is None else s.depth_m
        plan = raster.RasterPlan(
            Place(s.x_m, s.y_m), width_m, depth_m, s.pixels, s.lines, s.pixels * s.dwell_s, s.setpoint_n, s.gain_per_s,
            s.approach_m_per_s, s.settle_s, self._stiffness, self._limits.retract_position_m, s.setpoint_share * free_m,
            s.proportional, self._period_s, self._lag, self._approach_limit_s(s.approach_m_per_s),
        )  # fmt: skip
        reach_m, speed = self._lateral
        fault = raster.line_fault(plan, reach_m, speed, self._limits.force_limit_n)
        fault = fault or self._scan_fault(plan, free_m, place)
        if fault:
            raise RefusedError(f"scan: {fault}")
        self._start("scan")
        self._raster, self._free_amplitude_m = (plan, raster.begun(plan)), free_m
        seconds = 2.0 * plan.lines * plan.line_s
        return (
            f"an image of {s.pixels} x {s.lines} pixels begins, {seconds:.0f} s for its lines after an approach of at"
            f" most {plan.approach_s:.3g} s"
        )

    def _approach_limit_s(self, speed_m_per_s: float) -> float:
        return approach_limit_s(self._limits, self._limits.retract_position_m, speed_m_per_s)

    def _scan_fault(self, plan: raster.RasterPlan, free_m: float, place: Place) -> str:
        """Return why the base cannot follow the surface of an image, or the tip not get there; empty for nothing."""
        if self._reach is None:
            return ""
        image = self._reach.within(plan.centre, plan.width_m, plan.depth_m)
        # a tip that taps holds its amplitude above the sample, one in contact bends towards it
        press_m = -plan.amplitude_m if free_m > 0.0 else plan.setpoint_n / self._stiffness
        way = self._reach.along(place, raster.begin_of(plan))
        clear = self._reach.retracted_fault(image, free_m) or self._reach.retracted_fault(way, free_m)
        return self._reach.depth_fault(image, press_m) or clear

    def _begin_curve(self, settings: CurveSettings, place: Place) -> str:
        limits, s = self._limits, settings
        if not -s.start_m >= limits.base_min_m:
            raise RefusedError(f"curve.start_m = {s.start_m:g} m is beyond safety.base_min_m = {limits.base_min_m:g} m")
        if not s.load_n < limits.force_limit_n:
            raise RefusedError(f"curve.load_n must be below safety.force_limit_n = {limits.force_limit_n:g} N")
        if s.speed_m_per_s > limits.base_speed_m_per_s:
            raise RefusedError(
                f"curve.speed_m_per_s is above safety.base_speed_m_per_s = {limits.base_speed_m_per_s:g}"
            )
        if self._reach is not None:
            here = self._reach.along(place, place)
            begin = "The curve must begin with the base at {base:g} m or less (curve.start_m counts the other way)"
            if fault := self._reach.depth_fault(here) or self._reach.clearance_fault(here, -s.start_m, begin):
                raise RefusedError(f"curve: {fault}")
        plan = approach.CurvePlan(-s.start_m, s.load_n, s.speed_m_per_s, limits.base_max_m)
        self._start("curve")
        self._curve = (plan, approach.CurveState(approach.RISE, 0.0))
        return f"a force curve to {s.load_n:g} N begins"

    def _begin_tactile(self, settings: TactileSettings, place: Place) -> str:
        if self._lateral is None:
            raise RefusedError("program: tactile needs a lateral stage, which this instrument has none of")
        s = settings
        start = Place(s.x0_m, s.y0_m)
        end_x = s.x0_m + 0.5 * self._size_m[0] if s.x1_m is None else s.x1_m
        end = Place(end_x, s.y0_m if s.y1_m is None else s.y1_m)
        reach_m, fastest = self._lateral
        furthest = max(abs(value) for value in (*start, *end))
        if furthest > reach_m:
            raise RefusedError(f"tactile: the line reaches {furthest:.3g} m, and lateral.reach_m is {reach_m:g} m")
        if not s.setpoint_n < self._limits.force_limit_n:
            limit_n = self._limits.force_limit_n
            raise RefusedError(f"tactile.setpoint_n must be below safety.force_limit_n = {limit_n:g} N")
        felt = felt_speed_m_per_s(s.feature_m, s.bandwidth_hz)
        speed = min(s.speed_m_per_s, felt, fastest)
        plan = tactile.TactilePlan(
            start, end, s.drive == "pointer", speed, s.setpoint_n, s.hold == "force", s.gain_per_s, s.approach_m_per_s,
            self._stiffness, self._limits.retract_position_m, self._period_s,
            self._approach_limit_s(s.approach_m_per_s),
        )  # fmt: skip
        if fault := tactile.plan_fault(plan) or self._path_fault(plan, place):
            raise RefusedError(f"tactile: {fault}")
        self._start("tactile")
        self._tactile = (plan, tactile.TactileState(tactile.RISE, False))
        clipped = ""
        if speed < s.speed_m_per_s:
            clipped = f"; its speed is limited from {s.speed_m_per_s:g} to {speed:g} m/s"
            clipped += f": features of {s.feature_m:g} m at {s.bandwidth_hz:g} Hz (Eq. 14)" if speed == felt else ""
            self._notice = clipped.removeprefix("; ")
        return f"the tip touches the sample and goes along {'a pointer' if plan.by_pointer else 'a line'}{clipped}"

    def _path_fault(self, plan: tactile.TactilePlan, place: Place) -> str:
        """Return why the base cannot bring the tip to a path, or hold the force along it; empty for nothing."""
        if self._reach is None:
            return ""
        path = self._reach.along(plan.start, plan.start if plan.by_pointer else plan.end)
        held = path if plan.holds_force else self._reach.along(plan.start, plan.start)
        fault = self._reach.depth_fault(held, plan.setpoint_n / self._stiffness)
        way = self._reach.along(place, plan.start)
        return fault or self._reach.retracted_fault(path) or self._reach.retracted_fault(way)

    def take_notice(self) -> str:
        """Return, once for each time that it happens, that a speed is limited, or that a curve turned early."""
        if self._notice:
            notice, self._notice = self._notice, ""
            return notice
        is_limited = self._tactile is not None and self._tactile[1].is_limited
        was_limited, self._was_limited = self._was_limited, is_limited
        if not is_limited or was_limited or self._tactile is None:
            return ""
        speed = self._tactile[0].speed_m_per_s
        return f"the pointer is ahead of the tip, which goes at {speed:g} m/s: no faster motion is felt (Eq. 14)"

    def _start(self, name: str) -> None:
        self.name, self.state, self._aborted = name, "running", ""
        self._raster = self._curve = self._tactile = None
        self._free_amplitude_m = 0.0
        self._was_limited, self._notice = False, ""

    def step(self, measured: Measured, pointer: Place, dt: float) -> tuple[Wanted, FinishedLine | None]:
        """Take what was measured at the last step; return what is wanted for the next dt [s], and a finished line.

        Parameters: pointer, where a person wants the tip.
        """
        base_m, place, force_n = measured.base_m, measured.place, measured.force_n
        self._aborted = self._aborted or self._overdue(base_m)
        if self._aborted:
            return Wanted(safety.ACTION_RETRACT, base_m, place), None
        line: FinishedLine | None = None
        if self._raster is not None:
            plan, state = self._raster
            paused = self.state == "paused"
            state, reference_m, target, line = raster.raster_step(plan, state, measured, dt, paused=paused)
            self._raster, done = (plan, state), state.phase == raster.DONE
        elif self._tactile is not None:
            path, felt = self._tactile
            felt, reference_m, target = tactile.tactile_step(path, felt, base_m, place, force_n, pointer, dt)
            self._tactile, done = (path, felt), felt.phase == tactile.DONE
        else:
            assert self._curve is not None
            curve, way = self._curve
            was_loaded = way.loaded
            way, reference_m = approach.curve_step(curve, way, base_m, force_n, dt)
            if was_loaded and not way.loaded:
                self._notice = (
                    f"the curve turned at {way.turned_m:.3g} m, the furthest base (safety.base_max_m), where the force"
                    f" was {force_n:.3g} N: its load of {curve.load_n:g} N was not reached"
                )
            self._curve, target, done = (curve, way), place, way.phase == approach.DONE
        action = safety.ACTION_RETRACT if done else safety.ACTION_POSITION
        return Wanted(action, reference_m, target, 0.0 if done else self._free_amplitude_m), line

    def _overdue(self, base_m: float) -> str:
        """Return that an approach has found no surface in its time; empty while it may still find one."""
        if self._raster is not None and raster.found_nothing(*self._raster):
            limit_s = self._raster[0].approach_s
        elif self._tactile is not None and tactile.found_nothing(*self._tactile):
            limit_s = self._tactile[0].approach_s
        else:
            return ""
        return (
            f"the surface was not found within {limit_s:.3g} s, with the base at {base_m:.3g} m (safety.base_max_m is"
            f" {self._limits.base_max_m:g} m): bring the sample nearer, or allow the base to go further"
        )

    def follow_guard(self, mode: int, reason: int) -> None:
        """Take note of what the guard made of a step: it ends a program that is done, and one that it stops itself."""
        if mode in (safety.MODE_FOLLOW, safety.MODE_HOLD):
            return
        if reason != safety.REASON_RETRACT_REQUESTED and not self._aborted:
            self._aborted = f"the guard has retracted the tip: {safety.REASON_NAMES[reason]}"
        self.state = "ended" if self._aborted else "finished"

    def report(self) -> Report:
        """Return how far the program is."""
        text, share, line, lines = self._progress()
        if self.state == "finished":
            short = self._curve is not None and not self._curve[1].loaded
            reached = " without reaching its load" if short else ""
            text, share = f"the {self._label} is finished{reached}: the tip retracts", 1.0
        elif self.state == "ended":
            text = f"the {self._label} ended, {self._aborted}"
        return Report(self.name, self.state, text, 100.0 * share, line, lines)

    @property
    def _label(self) -> str:
        return "tactile path" if self.name == "tactile" else self.name

    def end(self) -> None:
        """Let go of a program that is over."""
        self.name, self._raster, self._curve, self._tactile = "", None, None, None

    def _progress(self) -> tuple[str, float, int, int]:
        if self._tactile is not None:
            felt_phase = self._tactile[1].phase
            steps = ("the tip rises", "the stage moves to the first point", "approach", "the surface is felt", "done")
            return steps[felt_phase], felt_phase / tactile.DONE, 0, 0
        if self._raster is None:
            assert self._curve is not None
            phase = self._curve[1].phase
            ways = ("the tip rises", "approach", "retraction", "the curve is complete")
            return ways[phase], phase / approach.DONE, 0, 0
        plan, state = self._raster
        texts = (
            "the tip rises",
            "the stage moves to the first point",
            "approach",
            "the amplitude settles" if plan.amplitude_m > 0.0 else "the force settles",
            "lines",
            "done",
        )
        way = min(state.elapsed_s / plan.line_s, 1.0) if state.phase == raster.LINES else 0.0
        done = 2.0 * state.line + float(state.backward) + way
        return texts[state.phase], min(done / (2.0 * plan.lines), 1.0), state.line, plan.lines

"""An image by the own scan of an instrument whose wire is too slow for the feedback of the node.

The base stays at its retracted position, and the instrument's own z-controller moves the tip. The guard of the node
still judges the force; every end of the image withdraws the tip.
"""

from typing import NamedTuple

from telenano.extend.instruments import OwnImage, OwnLine
from telenano.extend.programs import Begun, FinishedLine, Inputs, Instrument, Program, Progress, Wanted
from telenano.extend.stage import Place
from telenano.settings.program_settings import ScanSettings
from telenano.wire.errors import RefusedError

RISE, IMAGE, DONE = range(3)
# Time limit of the approach and of the settling of the instrument's own z-controller, without the first line [s].
_APPROACH_S = 70.0
# Controllers of this kind send a line in packets of this many pixels.
_PACKET = 16


class OwnScanPlan(NamedTuple):
    """The image, and the base at which the instrument takes over [m]."""

    image: OwnImage
    clear_m: float


class OwnScanState(NamedTuple):
    """Phase; number of lines received, there and back counted separately; time in the phase [s]."""

    phase: int = RISE
    lines: int = 0
    elapsed_s: float = 0.0


class OwnScanProgram(Program[ScanSettings, OwnScanPlan, OwnScanState]):
    """The program of an image that the instrument takes by itself, line by line there and back."""

    settings = ScanSettings
    title = "Scan"
    about = "What is imaged."

    def begin(self, settings: ScanSettings, instrument: Instrument, place: Place) -> Begun[OwnScanPlan, OwnScanState]:
        s, (width_m, depth_m) = settings, instrument.size_m
        image = OwnImage(
            s.x_m,
            s.y_m,
            width_m if s.width_m is None else s.width_m,
            depth_m if s.depth_m is None else s.depth_m,
            s.pixels,
            s.lines,
            s.pixels * s.pixel_s(),
            s.setpoint_n,
        )
        if fault := _fault(s, image, instrument):
            raise RefusedError(f"scan: {fault}")
        text = (
            f"an image of {s.pixels} x {s.lines} pixels by the instrument's own scan begins,"
            f" {2.0 * s.lines * image.line_s:.0f} s for its lines after its approach"
        )
        return Begun(OwnScanPlan(image, instrument.limits.retract_position_m), OwnScanState(), text)

    def step(self, plan: OwnScanPlan, state: OwnScanState, inputs: Inputs, dt: float) -> Wanted[OwnScanState]:
        if state.phase == RISE:
            phase = IMAGE if inputs.base_m <= plan.clear_m else RISE
            return Wanted(OwnScanState(phase), plan.clear_m, inputs.place)
        line = None if inputs.own is None else _finished(plan.image, inputs.own)
        lines = state.lines + (line is not None)
        is_done = lines == 2 * plan.image.lines
        state = OwnScanState(DONE if is_done else IMAGE, lines, state.elapsed_s + dt)
        return Wanted(state, plan.clear_m, inputs.place, is_done, line, image=None if is_done else plan.image)

    def progress(self, plan: OwnScanPlan, state: OwnScanState) -> Progress:
        line, lines = min(state.lines // 2, plan.image.lines - 1), plan.image.lines
        text = f"line {line + 1} of {lines}" if state.lines else "the instrument approaches"
        return Progress(text, state.lines / (2 * lines), line, lines)

    def searching_s(self, plan: OwnScanPlan, state: OwnScanState) -> tuple[float, float]:
        return 0.0 if state.lines else state.elapsed_s, _APPROACH_S + 4.0 * plan.image.line_s


def _fault(s: ScanSettings, image: OwnImage, instrument: Instrument) -> str:
    """Return the reason why the instrument cannot take the image, with a remedy; empty if it can."""
    if instrument.lateral is None:
        return "needs a lateral stage, and this instrument has none"
    if s.mode == "tapping":
        return "mode: this instrument takes images in contact; choose its mode in its own software"
    if s.pixels % _PACKET:
        return f"pixels = {s.pixels}: this instrument takes lines of {_PACKET}, {2 * _PACKET}, {3 * _PACKET}... pixels"
    reach_m, speed = instrument.lateral
    furthest = max(abs(image.x_m) + 0.5 * image.width_m, abs(image.y_m) + 0.5 * image.depth_m)
    if furthest > reach_m:
        return f"the image reaches {furthest:.3g} m from the centre, and lateral.reach_m is {reach_m:g} m"
    if image.width_m / image.line_s > speed:
        needed_s = image.width_m / speed / image.pixels
        return f"a line would be faster than lateral.speed_m_per_s = {speed:g} m/s: a dwell of {needed_s:.3g} s is not"
    if not 0.0 < image.setpoint_n < instrument.limits.force_limit_n:
        return f"the set-point {image.setpoint_n:g} N must be above 0 and below safety.force_limit_n"
    return ""


def _finished(image: OwnImage, own: OwnLine) -> FinishedLine:
    y_m = image.y_m + ((own.line + 0.5) / image.lines - 0.5) * image.depth_m
    half_m = 0.5 * image.width_m * (1.0 - 1.0 / image.pixels)
    ends = Place(image.x_m - half_m, y_m), Place(image.x_m + half_m, y_m)
    return FinishedLine(own.line, own.backward, *ends, own.height_m, None)


OWN_SCAN = OwnScanProgram()

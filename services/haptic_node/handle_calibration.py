"""Calibration of a handle by gauges and masses: raw samples of a device that is never driven, and straight lines."""

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from proto.errors import TelenanoError
from services.haptic_node import wire
from services.haptic_node.driver import DeviceError
from services.haptic_node.port import OpenPort, SerialPort
from services.haptic_node.serial_driver import ASK_EVERY_NS, HANDSHAKE_NS, identity_text

STANDARD_GRAVITY_M_PER_S2 = 9.80665
# of the span of all points: beyond it a point does not lie on a line
MOST_RESIDUAL = 0.02
_LOOK_S = 1e-3
_LEAST_SAMPLES = 20


class CalibrationError(TelenanoError):
    """Measured points from which no calibration follows; the text names the point."""


class RawPoint(NamedTuple):
    """Means of position and force in counts, and the standard errors of the means."""

    position: float
    position_error: float
    force: float
    force_error: float


class LineFit(NamedTuple):
    """value = (count - zero) * scale, with the standard error of the scale."""

    scale: float
    zero: float
    scale_error: float


def sample_raw(
    path: str,
    baud: int,
    duration_s: float,
    *,
    open_port: OpenPort = SerialPort,
    now_ns: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], None] = time.sleep,
) -> tuple[wire.Hello, RawPoint]:
    """Return who a handle is, and its means over a time [s], from what it sends by itself, without a command.

    Raises DeviceError if nobody answers, or if the device sends too few samples.
    """
    port, reader = open_port(path, baud), wire.FrameReader()
    hello: wire.Hello | None = None
    positions: list[int] = []
    forces: list[int] = []
    nonce, seq = now_ns() // 1000 & 0xFFFF, 0
    began_ns, asked_ns = now_ns(), now_ns() - ASK_EVERY_NS
    try:
        while hello is None or now_ns() - began_ns < round(duration_s * 1e9):
            if hello is None and now_ns() - asked_ns >= ASK_EVERY_NS:
                asked_ns = now_ns()
                port.write(wire.encode_ask(seq, nonce))
                seq += 1
            sleep(_LOOK_S)
            for answer in reader.answers(port.read()):
                if isinstance(answer, wire.Hello) and hello is None and answer.nonce == nonce:
                    hello, began_ns = answer, now_ns()
                elif isinstance(answer, wire.State) and hello is not None:
                    positions.append(answer.position)
                    forces.append(answer.force)
            if hello is None and now_ns() - began_ns > HANDSHAKE_NS:
                raise DeviceError(f"{path}: nothing answers in handle protocol {wire.MAJOR} at {baud} baud for 3 s")
    finally:
        port.close()
    if len(positions) < _LEAST_SAMPLES:
        raise DeviceError(f"{path}: {identity_text(hello)} sent {len(positions)} samples, {_LEAST_SAMPLES} are needed")
    return hello, RawPoint(*_mean(positions), *_mean(forces))


def fit_line(what: str, counts: Sequence[float], errors: Sequence[float], values: Sequence[float]) -> LineFit:
    """Return the straight line through measured points, by least squares.

    Parameters: counts with their standard errors, and the values that they stand for, two or more of each. The standard
    error of the scale is that of the counts or of the scatter about the line, whichever is greater.
    Raises CalibrationError where the counts do not differ, or a point is further off the line than 2 % of the span.
    """
    number = len(counts)
    mean_value, mean_count = sum(values) / number, sum(counts) / number
    spread = sum((value - mean_value) ** 2 for value in values)
    if number < 2 or spread == 0.0:
        raise CalibrationError(f"{what}: two different values are needed, found {', '.join(f'{v:g}' for v in values)}")
    pairs = list(zip(values, counts, strict=True))
    slope = sum((value - mean_value) * (count - mean_count) for value, count in pairs) / spread
    span = abs(slope) * (max(values) - min(values))
    if span <= 3.0 * max(errors) or span == 0.0:
        raise CalibrationError(f"{what}: the counts differ by {span:.3g} only, which is within their noise")
    residuals = [count - mean_count - slope * (value - mean_value) for value, count in pairs]
    worst, value = max(zip(map(abs, residuals), values, strict=True))
    if worst > MOST_RESIDUAL * span:
        raise CalibrationError(
            f"{what}: the point at {value:g} is {worst / span:.1%} of the span off the line, {MOST_RESIDUAL:.0%} are "
            "allowed: measure it again"
        )
    scatter = math.sqrt(sum(residual**2 for residual in residuals) / (number - 2) / spread) if number > 2 else 0.0
    noise = max(errors) / math.sqrt(spread)
    scale = 1.0 / slope
    return LineFit(scale, mean_count - slope * mean_value, max(scatter, noise) * scale**2)


def _mean(found: Sequence[int]) -> tuple[float, float]:
    mean = math.fsum(found) / len(found)
    variance = math.fsum((value - mean) ** 2 for value in found) / (len(found) - 1)
    return mean, math.sqrt(variance / len(found))

"""Calibration of a handle by gauges and masses: raw samples of a device that is never driven, and straight lines."""

import time
from collections.abc import Callable
from typing import NamedTuple

from telenano.devices.hand import wire
from telenano.devices.hand.port import OpenPort, SerialPort
from telenano.devices.hand.serial_driver import ASK_EVERY_NS, HANDSHAKE_NS, identity_text
from telenano.extend.devices import DeviceError
from telenano_calibration.line_fit import mean_of

STANDARD_GRAVITY_M_PER_S2 = 9.80665
_LOOK_S = 1e-3
_LEAST_SAMPLES = 20


class RawPoint(NamedTuple):
    """Means of position and force in counts, and the standard errors of the means."""

    position: float
    position_error: float
    force: float
    force_error: float


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

    Raises:
        DeviceError: No device answers, or it sends too few samples.
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
    return hello, RawPoint(*mean_of(positions), *mean_of(forces))

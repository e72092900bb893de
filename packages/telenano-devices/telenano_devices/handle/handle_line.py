"""A wire in virtual time between the driver of the handle and the emulated handle; a test can replace its bytes."""

from collections.abc import Callable
from typing import Any

from telenano.devices import HandleCalibration, SerialHandle
from telenano.extend.hands import DeviceError
from telenano.sections import HapticConfig
from telenano.settings import validate
from telenano.testing import HandRig, NodeBench
from telenano_devices.handle.emulated_handle import EmulatedHandle, calibration_of

PATH = "/dev/serial/by-id/telenano"
_MS = 1_000_000


def calibration(**changes: Any) -> HandleCalibration:
    """Return the calibration of the emulated handle, with changes to some keys."""
    return validate(HandleCalibration, {**calibration_of(HapticConfig()), **changes}, "handle.yaml")


class HandleLine:
    """The port that the driver opens, and the device at its other end; time passes in `sleep` and `pass_ms`.

    Args:
        calibrated: The calibration of the driver; None for that of the emulated handle.
    """

    def __init__(self, calibrated: HandleCalibration | None = None) -> None:
        self.now_ns = 10**9
        self.handle = EmulatedHandle(HapticConfig(), session=0xBEEF)
        self.plugged, self.reading = True, True
        # Name of another program that has the port open, empty for none.
        self.holder = ""
        self.to_host: Callable[[bytes], bytes] = lambda sent: sent
        self.to_device: Callable[[bytes], bytes] = lambda sent: sent
        # Delay of the bytes from the device [ms].
        self.latency_ms = 0.0
        self.opened = 0
        self.closed = 0
        self._waiting: list[tuple[int, bytes]] = []
        self.driver = SerialHandle(
            PATH,
            1_000_000,
            calibration() if calibrated is None else calibrated,
            HapticConfig().limits,
            open_port=self._open,
            now_ns=lambda: self.now_ns,
            sleep=lambda duration_s: self.pass_ms(max(1, round(duration_s * 1e3))),
        )

    def _open(self, path: str, baud: int) -> "HandleLine":
        if not self.plugged:
            raise DeviceError(f"{path}: there is no such port")
        if self.holder:
            raise DeviceError(f"{path}: is in use by {self.holder}: end it first")
        self.opened += 1
        self._waiting.clear()
        return self

    def read(self) -> bytes:
        if not self.plugged:
            raise DeviceError(f"{PATH}: the device is gone")
        due = [sent for at_ns, sent in self._waiting if at_ns <= self.now_ns]
        self._waiting = [(at_ns, sent) for at_ns, sent in self._waiting if at_ns > self.now_ns]
        return b"".join(due)

    def write(self, frame: bytes) -> bool:
        if not self.plugged:
            raise DeviceError(f"{PATH}: the device is gone")
        if self.reading:
            self.handle.receive(self.to_device(frame))
            self._collect()
        return self.reading

    def close(self) -> None:
        self.closed += 1

    def pass_ms(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            self.now_ns += _MS
            self.handle.advance()
            self._collect()

    def _collect(self) -> None:
        sent = self.to_host(self.handle.sent())
        if sent and self.plugged:
            # Bytes stay in order when the latency changes.
            before_ns = self._waiting[-1][0] if self._waiting else 0
            self._waiting.append((max(before_ns, self.now_ns + round(self.latency_ms * _MS)), sent))


class HandleRig(HandRig):
    """A haptic node with the emulated handle on a bench."""

    def __init__(self, bench: NodeBench) -> None:
        super().__init__(bench, HandleLine())

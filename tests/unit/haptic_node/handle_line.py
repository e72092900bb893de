"""A line between the serial driver and the emulated handle in virtual time, whose bytes a test can tamper with."""

from collections.abc import Callable
from typing import Any

import yaml

from services.haptic_node.calibration import HandleCalibration
from services.haptic_node.config import HapticConfig
from services.haptic_node.driver import DeviceError
from services.haptic_node.emulated_handle import EmulatedHandle, calibration_of
from services.haptic_node.serial_driver import SerialHandle
from services.runtime.config import parse_yaml, validate

PATH = "/dev/serial/by-id/telenano"
MS = 1_000_000


def calibration(**changes: Any) -> HandleCalibration:
    document = {**calibration_of(HapticConfig()), **changes}
    return validate(HandleCalibration, parse_yaml(yaml.safe_dump(document).encode(), "handle.yaml"), "handle.yaml")


class Line:
    """The port that the driver opens, and the device at its other end; time passes in `sleep` and `pass_ms`."""

    def __init__(self, calibrated: HandleCalibration | None = None) -> None:
        self.now_ns = 10**9
        self.handle = EmulatedHandle(HapticConfig(), session=0xBEEF)
        self.plugged, self.reading = True, True
        self.to_host: Callable[[bytes], bytes] = lambda sent: sent
        self.to_device: Callable[[bytes], bytes] = lambda sent: sent
        # of what the device sent [ms]
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

    def _open(self, path: str, baud: int) -> "Line":
        if not self.plugged:
            raise DeviceError(f"{path}: there is no such port")
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
            self.now_ns += MS
            self.handle.advance()
            self._collect()

    def _collect(self) -> None:
        sent = self.to_host(self.handle.sent())
        if sent and self.plugged:
            self._waiting.append((self.now_ns + round(self.latency_ms * MS), sent))

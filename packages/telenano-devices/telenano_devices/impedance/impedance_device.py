"""The node's view of a device of impedance type behind its servo: a `HapticDevice` on top of a `ServoLink`."""

import time
from collections.abc import Callable
from typing import Any, Literal

from telenano.extend.hands import (
    MODE_OFF,
    MODE_POSITION,
    Capabilities,
    DeviceError,
    DeviceReading,
    DriveCommand,
    HapticReport,
)
from telenano_devices.impedance.coupling import ZERO, reading_of
from telenano_devices.impedance.impedance_config import CouplingConfig
from telenano_devices.impedance.servo import ServoCommand, ServoLink, ServoSample

# A sample older than this is stale; beyond the silence of the coupling the device is lost.
_STALE_S = 0.005
_SILENT = "the servo of the device is silent: the device counts as lost"


class ImpedanceDevice:
    """The node's side of a device whose servo renders the coupling: it sends references and receives samples."""

    state: Any = None

    def __init__(
        self,
        link: ServoLink,
        coupling: CouplingConfig,
        period_s: float,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._link, self._coupling, self._period_s, self._now_ns = link, coupling, period_s, now_ns
        self._opened = False
        self._counter = self._arm_count = 0
        self._reference_m: float | None = None
        self._sample = ServoSample()
        self._report = HapticReport("lost", 0.0, False, "")

    @property
    def capabilities(self) -> Capabilities:
        return self._link.capabilities

    @property
    def report(self) -> HapticReport:
        return self._report

    def open(self) -> None:
        """Find the device and start its servo, without force.

        Raises:
            DeviceError: The device is not ready; the message says what is missing.
        """
        self._link.open()
        self._opened = True
        self._settings = self._coupling.to_settings(self.capabilities)
        self._ready_text = f"{self.capabilities.identity}: {self._coupling.bounds(self.capabilities).sentence()}"
        self._report = HapticReport("stale", 0.0, False, self._ready_text)
        self._send(DriveCommand(MODE_OFF, 0.0, 0.0))

    def close(self) -> None:
        """Remove the force and end the servo; harmless when already closed."""
        if self._opened:
            self.make_safe()
            self._opened = False
        self._link.close()

    def write(self, command: DriveCommand) -> None:
        self._require_open()
        if command.mode not in (MODE_OFF, MODE_POSITION):
            raise DeviceError(f"mode {command.mode} is not one of this device's: 0 (off), 1 (position)")
        self._arm_count += command.spatial.arm
        self._send(command)

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        """Return the newest sample of the servo, and update the report with its age and status."""
        self._require_open()
        sample = self._link.newest(session_time_s, dt_s)
        if sample is not None:
            self._sample = sample
        age_s = max(0.0, (self._now_ns() - self._sample.taken_ns) * 1e-9)
        status: Literal["ok", "stale", "lost"] = "ok" if age_s <= _STALE_S else "stale"
        text = self._ready_text
        if self._sample.error:
            status, text = "lost", self._sample.error
        elif age_s > self._coupling.silence_s:
            status, text = "lost", _SILENT
        self._report = HapticReport(status, age_s, False, text)
        if status == "lost":
            # The force of the last sample no longer acts.
            return reading_of_sample(self._sample._replace(velocity_m_per_s=ZERO, force_n=ZERO))
        return reading_of_sample(self._sample)

    def make_safe(self) -> None:
        """Disengage the device now, so that the servo gives no force."""
        if self._opened:
            self._send(DriveCommand(MODE_OFF, 0.0, 0.0))

    def _send(self, command: DriveCommand) -> None:
        self._counter += 1
        engaged = command.mode == MODE_POSITION
        x, before = command.position_reference_m, self._reference_m
        velocity = (x - before) / self._period_s if engaged and before is not None else 0.0
        self._reference_m = x if engaged else None
        (side_x, side_y), (pull_x, pull_y) = command.spatial.lateral_m, command.spatial.lateral_force_n
        self._link.send(
            ServoCommand(
                counter=self._counter,
                sent_ns=self._now_ns(),
                position_m=(side_x, side_y, 0.0 - x),
                velocity_m_per_s=(0.0, 0.0, 0.0 - velocity),
                force_n=(pull_x, pull_y, 0.0) if engaged else ZERO,
                engaged=engaged,
                arm_count=self._arm_count,
                stop=False,
                settings=self._settings,
            )
        )

    def _require_open(self) -> None:
        if not self._opened:
            raise DeviceError("the device is not open: call open() first")


def reading_of_sample(sample: ServoSample) -> DeviceReading:
    """Return the sample of a servo as a reading along the paper's axis."""
    marks, energies_j = (sample.limited, False, sample.gate), (sample.hand_energy_j, sample.coupling_energy_j)
    handle = sample.orientation, sample.buttons
    return reading_of(sample.position_m, sample.velocity_m_per_s, sample.force_n, marks, handle, energies_j)

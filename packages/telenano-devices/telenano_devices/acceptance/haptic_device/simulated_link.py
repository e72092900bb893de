"""A simulated impedance device behind the same interface as a real one, into which faults can be put on purpose.

Its servo is `servo.Servo`, called in virtual time: each `newest` lets dt_s pass. The hand pulls through a spring and a
damper along a path of its own on all three axes.
"""

import math
from collections import deque
from collections.abc import Callable
from random import Random
from typing import NamedTuple

from telenano.extend.hands import Capabilities
from telenano_devices.impedance.coupled import arm_step
from telenano_devices.impedance.coupling import UPRIGHT, ZERO, Quaternion, Vector
from telenano_devices.impedance.emulated_arm import HandMotion
from telenano_devices.impedance.servo import DeviceSample, Servo, ServoCommand, ServoSample


class DeviceFaults(NamedTuple):
    """Faults of the device; the defaults are those of a good one.

    axes, signs: axis of the mechanics that each reading shows, and its sign. scale: factor of the position.
    force_scale: factor of the force of the drive, negative for a wrong sign. noise_m, drift_m_per_s, step_m: noise,
    drift and resolution of the position. hold_s: time for which each reading is repeated [s]. late_s: age of the
    readings [s]. slow: factor of the servo's period. every, stumble: each `every`-th step lasts `stumble` periods.
    nan_at_s, jump_at_s, frozen_at_s, gap_at_s: times at which the fault begins [s]; gap_s: length of the silence [s].
    reported_force: factor of the reported force. quaternion: reading of the wrist. stuck_buttons, dead_buttons: bits
    that are always and never set. unplug_is_reported: whether the device reports an unplugged cable as an error.
    extra_delay_s: delay of the drive beyond the declared one [s]. deadman_is_ignored: whether the servo ignores it.
    """

    axes: tuple[int, int, int] = (0, 1, 2)
    signs: Vector = (1.0, 1.0, 1.0)
    scale: float = 1.0
    force_scale: float = 1.0
    noise_m: float = 2e-6
    drift_m_per_s: float = 0.0
    step_m: float = 1e-5
    hold_s: float = 0.0
    late_s: float = 0.0
    slow: float = 1.0
    every: int = 0
    stumble: int = 4
    nan_at_s: float = math.inf
    jump_at_s: float = math.inf
    frozen_at_s: float = math.inf
    gap_at_s: float = math.inf
    gap_s: float = 0.0
    reported_force: float = 1.0
    quaternion: Quaternion = UPRIGHT
    stuck_buttons: int = 0
    dead_buttons: int = 0
    unplug_is_reported: bool = True
    extra_delay_s: float = 0.0
    deadman_is_ignored: bool = False


# The noise of the simulated device is the same in every take.
_SEED = 1
_GOOD = DeviceFaults()


class SimulatedLink:
    """A `ServoLink` whose device, servo and hand live in virtual time."""

    def __init__(
        self,
        capabilities: Capabilities,
        hand: Callable[[float], HandMotion] = lambda time_s: HandMotion(),
        faults: DeviceFaults = _GOOD,
    ) -> None:
        self._capabilities, self._hand, self._faults = capabilities, hand, faults
        self._period_s = faults.slow / capabilities.rate_hz
        self._servo = Servo(1.0 / capabilities.rate_hz)
        self.place_m: list[float] = [0.0, 0.0, 0.0]
        self.velocity_m_per_s: list[float] = [0.0, 0.0, 0.0]
        self.force_n: Vector = ZERO
        self.time_s = 0.0
        self._due_s = self._period_s
        self._noise, self._steps = Random(_SEED), 0
        self._command: ServoCommand | None = None
        self._newest: ServoSample | None = None
        self._read = DeviceSample(ZERO, 0)
        self._old: deque[DeviceSample] = deque()
        # Forces delayed by the drive, with the times at which they act.
        self._late: deque[tuple[float, Vector]] = deque()
        self._stepped_s = 0.0

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def open(self) -> None:
        """Do nothing: the simulated device needs no opening, and starts without force."""

    def send(self, command: ServoCommand) -> None:
        self._command = command

    def close(self) -> None:
        """Withdraw the command, so that the device gives no force."""
        self._command = None

    def now_ns(self) -> int:
        """Return the virtual time on the clock of this device [ns]."""
        return round(self.time_s * 1e9)

    def newest(self, session_time_s: float, dt_s: float) -> ServoSample | None:
        """Let dt_s [s] pass; return the last sample of the servo, None before the first."""
        end_s = self.time_s + dt_s
        while self._due_s <= end_s + 1e-12:
            self._move_to(self._due_s)
            self._run_servo()
        self._move_to(end_s)
        return self._newest

    def _move_to(self, end_s: float) -> None:
        """Move the arm up to end_s [s] under the forces of drive and hand, which change at their own times."""
        while self._late and self._late[0][0] <= end_s:
            at_s, force = self._late.popleft()
            self._advance(at_s)
            self.force_n = force
        self._advance(end_s)

    def _advance(self, end_s: float) -> None:
        h = end_s - self.time_s
        if h <= 1e-12:
            return
        motion, able = self._hand(end_s), self._capabilities
        reach = able.workspace_max_m
        for axis in range(3):
            x, v = self.place_m[axis], self.velocity_m_per_s[axis]
            pull = self.force_n[axis] * self._faults.force_scale + motion.force_n[axis]
            free, _ = arm_step(able.mass_kg, able.damping_n_s_per_m, x, v, pull, h)
            unit, _ = arm_step(able.mass_kg, able.damping_n_s_per_m, 0.0, 0.0, 1.0, h)
            k, c = motion.stiffness_n_per_m, motion.damping_n_s_per_m
            hand = k * (motion.place_m[axis] - 0.5 * (x + free)) - c * (free - x) / h
            hand /= 1.0 + unit * (0.5 * k + c / h)
            x, v = arm_step(able.mass_kg, able.damping_n_s_per_m, x, v, pull + hand, h)
            self.place_m[axis], self.velocity_m_per_s[axis] = (
                (x, v) if abs(x) < reach else (math.copysign(reach, x), 0.0)
            )
        self.time_s = end_s

    def _run_servo(self) -> None:
        faults, motion = self._faults, self._hand(self.time_s)
        self._steps += 1
        self._due_s += self._period_s * (faults.stumble if faults.every and self._steps % faults.every == 0 else 1)
        self._read = self._sample(motion)
        silent = faults.gap_at_s <= self.time_s < faults.gap_at_s + faults.gap_s
        if silent:
            return
        dt_s, self._stepped_s = self.time_s - self._stepped_s, self.time_s
        command = self._command
        if command is not None and faults.deadman_is_ignored:
            command = command._replace(settings=command.settings._replace(needs_deadman=False))
        force, sample = self._servo.step(command, self._read, self.now_ns(), max(dt_s, 1e-9))
        reported = _times(force, faults.reported_force)
        self._newest = sample._replace(force_n=reported)
        at_s = self.time_s + self._capabilities.drive_delay_s + faults.extra_delay_s
        self._late.append((at_s, force if motion.plugged else ZERO))

    def _sample(self, motion: HandMotion) -> DeviceSample:
        """Return the present reading of the device, with its faults."""
        faults, now_ns, last = self._faults, self.now_ns(), self._read
        if not motion.plugged:
            if not faults.unplug_is_reported:
                return last._replace(taken_ns=now_ns, deadman_ns=now_ns)
            return last._replace(error="the device has gone: its cable is out, or it has no power")
        if self.time_s >= faults.frozen_at_s:
            return last._replace(taken_ns=now_ns, deadman_ns=now_ns)
        if faults.hold_s and last.taken_ns and now_ns - last.deadman_ns < faults.hold_s * 1e9:
            return last._replace(taken_ns=now_ns)
        place = tuple(self._read_axis(axis) for axis in range(3))
        if faults.nan_at_s <= self.time_s < faults.nan_at_s + 0.005:
            place = (math.nan, math.nan, math.nan)
        buttons = (motion.buttons | faults.stuck_buttons) & ~faults.dead_buttons
        deadman = not self._capabilities.deadman or bool(
            buttons >> self._capabilities.buttons.index(self._capabilities.deadman) & 1
        )
        sample = DeviceSample((place[0], place[1], place[2]), now_ns, faults.quaternion, buttons, deadman, now_ns)
        if not faults.late_s:
            return sample
        self._old.append(sample)
        while len(self._old) > 1 and self._old[1].taken_ns <= now_ns - faults.late_s * 1e9:
            self._old.popleft()
        return self._old[0]

    def _read_axis(self, axis: int) -> float:
        faults = self._faults
        x = faults.scale * faults.signs[axis] * self.place_m[faults.axes[axis]] + faults.drift_m_per_s * self.time_s
        x += faults.noise_m * self._noise.gauss(0.0, 1.0)
        if self.time_s >= faults.jump_at_s:
            x += 0.01
        return round(x / faults.step_m) * faults.step_m if faults.step_m else x


def _times(vector: Vector, factor: float) -> Vector:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor

"""A simulated impedance device behind the same interface as a real one, with faults that can be put in on purpose.

Its servo is `servo.Servo`, called in virtual time: each `newest` lets dt_s pass. The hand goes a way of its own on all
three axes, on a spring and a damper, and lets go within a pair of times.
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
    """What is wrong with the device; the defaults are a good one. From `begins_s` on [s].

    axes, signs: which axis of the mechanics each reading is of, and its sign. scale: of the place. force_scale: of the
    force that the drive gives, negative for a wrong sign. noise_m, drift_m_per_s, step_m: of the place. hold_s: how
    long each reading is repeated. late_s: how old readings are. slow: periods of the servo in one. every, stumble: one
    step in this number of takes this number of periods. nan_at_s, jump_at_s, frozen_at_s: when; gap_s: silence.
    reported_force: by which the reported force is multiplied. quaternion: what a wrist says. stuck_buttons,
    dead_buttons: bits that are always and never set. unplug_is_reported: whether a cable that is out ends the samples.
    extra_delay_s: of the drive, beyond what is declared. deadman_is_ignored: by the servo.
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
        # forces on their way through the drive, with the times at which they act
        self._late: deque[tuple[float, Vector]] = deque()
        self._stepped_s = 0.0

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def open(self) -> None:
        """Come up without force."""

    def send(self, command: ServoCommand) -> None:
        self._command = command

    def close(self) -> None:
        """Let go of the hand."""
        self._command = None

    def now_ns(self) -> int:
        """Return the virtual time on the clock of this device [ns]."""
        return round(self.time_s * 1e9)

    def newest(self, session_time_s: float, dt_s: float) -> ServoSample | None:
        """Let dt_s pass; return what the servo reported last."""
        end_s = self.time_s + dt_s
        while self._due_s <= end_s + 1e-12:
            self._move_to(self._due_s)
            self._run_servo()
        self._move_to(end_s)
        return self._newest

    def _move_to(self, end_s: float) -> None:
        """Let the arm move under the forces of drive and hand, which change at their own times."""
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
        """Return what the device says now, with everything that is wrong with it."""
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

"""The motion by which a handle on a serial port is judged, and its recording: one row a millisecond.

The handle is first only read; then it moves to and fro without a hand; then it holds its position against a hand, gets
no commands until its watchdog switches it off, and has its cable pulled out.
"""

import math
from typing import Any, NamedTuple

from telenano.devices import HandleCalibration
from telenano.extend.hands import MODE_OFF, MODE_POSITION, Capabilities, DriveCommand
from telenano.wire import TelenanoError
from telenano_devices.acceptance.take import (
    PERIOD_S,
    SILENT,
    Clock,
    EndedError,
    Guide,
    Recorder,
    Step,
    Table,
    Take,
    row_of,
)

STATUSES = ("ok", "stale", "lost")
STEPS = (
    Step("rest", 4.0, "let go of the handle"),
    Step("push", 6.0, "push the handle towards the sample, for two seconds, and let go"),
    Step("follow", 6.0, "take your hands off: the handle moves to and fro by some millimetres", "without load"),
    Step("hold", 6.0, "push the handle gently towards the sample, for two seconds: it holds its place", "with load"),
    Step("silence", 1.5, "let go: nothing is sent, and the handle switches its drive off by itself", "with load"),
    Step("cable", 8.0, "pull the cable of the handle out, wait for two seconds, and put it in again", "with load"),
)
# The amplitude of the motion of the step *follow*.
_AMPLITUDE_M = 2e-3
# The amplitude is at most this share of the workspace.
_SHARE = 0.2
# The period of the motion of the step *follow*.
_PERIOD_S = 3.0
# Time in the step *silence* before the commands stop.
_BEFORE_S = 0.3
# Time by which the silence exceeds the watchdog of the handle.
_SPARE_S = 0.1
# The largest number of messages of the driver that are kept.
_MOST_MESSAGES = 16
ROW = row_of(
    ("asked_m", "f8"),
    ("place_m", "f8"),
    ("hand_n", "f8"),
    ("motor_n", "f8"),
    ("status", "i2"),
    ("is_driven", "?"),
    ("tripped", "?"),
    ("estop", "?"),
    ("bad", "i8"),
    ("missed", "i8"),
)


class Facts(NamedTuple):
    """The inputs of the checks besides the rows.

    device: its declared capabilities; watchdog_s: silence after which the drive is off [s]; max_drive_n: largest force
    of the drive [N]; amplitude_m: amplitude of the step *follow* [m]; device_messages: faults that the driver reported,
    each once; stopped: reason why the motion ended early.
    """

    device: Capabilities
    watchdog_s: float
    max_drive_n: float
    amplitude_m: float
    device_messages: tuple[str, ...] = ()
    stopped: str = ""

    @property
    def identity(self) -> str:
        return self.device.identity

    def tables(self) -> list[Table]:
        return [Table("What was declared", "", self.device._asdict())]


def facts_of(driver: Any, calibration: HandleCalibration) -> Facts:
    """Return the facts of an open handle before its take."""
    device: Capabilities = driver.capabilities
    reach_m = device.workspace_max_m - device.workspace_min_m
    return Facts(device, calibration.watchdog_s, calibration.max_force_n, min(_AMPLITUDE_M, _SHARE * reach_m))


def record_take(driver: Any, facts: Facts, clock: Clock, guide: Guide = SILENT) -> Take[Facts]:
    """Lead the person through the steps and record them; the handle must be open, and stays open with its drive off.

    If the motion ends early, the facts give the reason and the take has the rows recorded until then.

    Args:
        driver: The handle, a `SerialHandle`.
        facts: The facts known beforehand.
        clock: The clock of the handle.
        guide: The guide of the person.
    """
    guide.met(facts.identity)
    recorder = Recorder(STEPS, clock, guide)
    motion = _Motion(driver, facts, recorder, clock)
    try:
        for number, step in enumerate(STEPS):
            if recorder.wanted(number, motion.idle):
                recorder.begin(number)
                motion.run(step)
    except (EndedError, TelenanoError) as error:
        facts = facts._replace(stopped=f"{error} (in the step {recorder.step.name})")
    driver.make_safe()
    return recorder.take(ROW, facts._replace(device_messages=tuple(motion.driver_messages)))


class _Motion:
    """Drives and records the steps, one row a millisecond."""

    def __init__(self, driver: Any, facts: Facts, recorder: Recorder, clock: Clock) -> None:
        self._driver, self._facts, self._recorder, self._clock = driver, facts, recorder, clock
        self._can_drive = MODE_POSITION in facts.device.modes
        self._session_s = -1.0
        self.driver_messages: dict[str, None] = {}

    def idle(self) -> None:
        """Let a millisecond pass with the drive off."""
        self._clock.wait(self._clock.now_ns() + round(PERIOD_S * 1e9))
        self._driver.write(DriveCommand(MODE_OFF, 0.0, 0.0))
        self._driver.read(-1.0, PERIOD_S)

    def run(self, step: Step) -> None:
        """Drive the handle through a step, and record it."""
        home_m = self._tick(None).position_m
        self._session_s = 0.0 if step.name in ("push", "hold") else -1.0
        count = round(step.seconds / PERIOD_S)
        silent_s = self._facts.watchdog_s + _SPARE_S
        for index in range(count - 1):
            time_s = index * PERIOD_S
            if step.name == "follow":
                self._tick(home_m + self._facts.amplitude_m * math.sin(2.0 * math.pi * time_s / _PERIOD_S) ** 2)
            elif step.name in ("hold", "silence", "cable"):
                if step.name == "silence" and index == round(_BEFORE_S / PERIOD_S):
                    self._recorder.wait(round(silent_s / PERIOD_S))
                self._tick(home_m)
            else:
                self._tick(None)

    def _tick(self, reference_m: float | None) -> Any:
        """Send a position reference [m], or off for None, read the handle, record a row, and return the reading."""
        driver, recorder = self._driver, self._recorder
        recorder.wait()
        is_driven = reference_m is not None and self._can_drive
        driver.write(DriveCommand(MODE_POSITION if is_driven else MODE_OFF, reference_m or 0.0, 0.0))
        if self._session_s >= 0.0:
            self._session_s += PERIOD_S
        reading, report = driver.read(self._session_s, PERIOD_S), driver.report
        if report.status == "lost" and len(self.driver_messages) < _MOST_MESSAGES:
            self.driver_messages[report.text] = None
        tripped = driver.state is not None and driver.state.watchdog_tripped
        recorder.add(
            report.age_s, reading.position_m if reference_m is None else reference_m, reading.position_m,
            reading.operator_force_n, reading.motor_force_n, STATUSES.index(report.status), is_driven, tripped,
            report.estop_pressed, sum(driver.reader.errors.values()), driver.missed,
        )  # fmt: skip
        return reading

"""The motion by which an instrument is judged, and its recording: one row a millisecond, behind the guard.

The tip rests retracted; the base goes away from the sample and back; it approaches until the sample presses; it steps
to and fro in contact, by less than would lose the contact; it stands half way above the sample while this process is
silent; and it comes back. Every motion goes through the guard of the node (`safety_step`), with its limits.
"""

import contextlib
import math
from typing import NamedTuple

from telenano.afm import TipGuard
from telenano.extend.instruments import AfmDriver, SafetyParams
from telenano.extend.samples import AfmSample
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
    Step("rest", 3.0, "the tip stays retracted"),
    Step("range", 2.0, "the base goes to its end away from the sample, and back", "without load"),
    Step("approach", 60.0, "the base goes towards the sample until it presses; this may end early", "with load"),
    Step("contact", 5.0, "the base steps there and back in contact", "with load"),
    Step("silence", 1.0, "nothing is sent, with the tip half way above the sample", "with load"),
    Step("back", 3.0, "the instrument is driven again, and the tip stays retracted", "with load"),
)
# The approach ends at this multiple of the force that counts as contact.
_PRESS = 10.0
# The approach ends at most at this share of the force limit.
_PRESS_SHARE = 0.1
# A step in contact changes the force by this share of the force at which the approach ends.
_STEP_SHARE = 0.8
# The steps in contact lie deeper by this multiple of the deflection at which the approach ended, because an attraction
# that is read with the wrong sign also ends the approach.
_FURTHER = 2.0
# The largest attraction during an approach, as a share of the force limit.
_PULL_SHARE = 0.5
# Delay of an answer beyond the declared latency at which the approach presses twice as hard [s].
_SPARE_S = 5e-3
# The number of steps in contact.
_EDGES = 24
# The least time for which the tip stands at each end of a step.
_LEAST_HALF_S = 0.1
# Time by which the silence exceeds the guard's heartbeat.
_SILENT_S = 0.3
# Time limit for the instrument to come back after the silence.
_BACK_S = 10.0
# The instrument is back after this many samples in a row without a loss; a driver may notice a loss late.
_GOOD = 600
ROW = row_of(
    ("asked_m", "f8"),
    ("base_m", "f8"),
    ("force_n", "f8"),
    ("value", "f8"),
    ("fresh", "i8"),
    ("status", "i2"),
    ("in_range", "?"),
)


class Facts(NamedTuple):
    """The inputs of the checks besides the rows.

    driver: value of `afm_node.driver`; identity: the instrument in words; latency_s: declared latency [s]; sample_hz:
    declared rate of samples [Hz]; stiffness_n_per_m: stiffness of the cantilever [N/m]; contact_force_n: force that
    counts as contact [N]; limits: those of the guard; press_n: force at which the approach ends [N]; safe_m: base in
    the safe state [m]; heartbeat_s: silence after which a guard or script retracts [s], 0 if there is none; silent_s:
    length of the silence [s]; retractions: counts of the guard or script before and after it, None if it has no count;
    stopped: reason why the motion ended early.
    """

    driver: str
    identity: str
    latency_s: float
    sample_hz: float
    stiffness_n_per_m: float
    contact_force_n: float
    limits: SafetyParams
    press_n: float
    safe_m: float
    heartbeat_s: float = 0.0
    silent_s: float = 0.0
    retractions: tuple[int | None, int | None] = (None, None)
    stopped: str = ""

    def tables(self) -> list[Table]:
        values = self._asdict()
        limits = values.pop("limits")._asdict()
        return [
            Table("What was declared", "", values),
            Table("The limits of the guard", "The motion was kept within them.", limits),
        ]


PULLED = "the tip is pulled by half of the limit of the force: its sign may be wrong, or the sample adheres"


class _StoppedError(Exception):
    """The guard has ended the motion, or the motion cannot continue."""


def record_take(driver: AfmDriver, facts: Facts, clock: Clock, guide: Guide = SILENT) -> Take[Facts]:
    """Lead an instrument through the motion and record it; the instrument must be open, and stays open, retracted.

    If the motion ends early, the facts give the reason and the take has the rows recorded until then.

    Args:
        driver: The instrument.
        facts: The facts known beforehand.
        clock: The clock of the instrument.
        guide: The guide of the person; declining a step ends the motion, because the next steps need it.
    """
    guide.met(facts.identity)
    limits, recorder = facts.limits, Recorder(STEPS, clock, guide)
    moved = _Motion(driver, limits, recorder, clock)
    before, heartbeat_s = _retractions(driver), float(getattr(driver, "heartbeat_s", 0.0))
    silent_s = 0.0
    try:
        moved.begin(0)
        moved.stand(STEPS[0].seconds)
        moved.begin(1)
        moved.go(limits.base_min_m)
        moved.stand(0.5)
        moved.go(limits.retract_position_m)
        moved.stand(0.5)
        moved.begin(2)
        lag_s = facts.latency_s + _SPARE_S
        reach_m = limits.base_max_m - limits.retract_position_m
        speed = max(facts.press_n / (facts.stiffness_n_per_m * lag_s), reach_m / STEPS[2].seconds)
        speed = min(speed, limits.base_speed_m_per_s)
        contact_m = moved.approach(facts.press_n, speed)
        near_m = 0.5 * (limits.retract_position_m + contact_m)
        if moved.begin(3, near_m):
            # The surface may have drifted while the tip waited above it.
            moved.records = False
            contact_m = moved.approach(facts.press_n, speed)
            moved.records = True
        contact_m += _FURTHER * facts.press_n / facts.stiffness_n_per_m
        moved.steps_in_contact(
            contact_m,
            _STEP_SHARE * facts.press_n / facts.stiffness_n_per_m,
            max(_LEAST_HALF_S, 6.0 * facts.latency_s),
        )
        near_m = 0.5 * (limits.retract_position_m + contact_m)
        moved.begin(4, near_m)
        moved.go(near_m)
        moved.stand(0.2)
        before = _retractions(driver)
        silent_s = heartbeat_s + _SILENT_S
        recorder.wait(round(silent_s / PERIOD_S))
        recorder.begin(5)
        moved.come_back()
    except (_StoppedError, EndedError, TelenanoError) as error:
        facts = facts._replace(stopped=str(error))
        moved.records = True
        moved.retract()
    facts = facts._replace(heartbeat_s=heartbeat_s, silent_s=silent_s, retractions=(before, _retractions(driver)))
    return recorder.take(ROW, facts)


def _retractions(driver: AfmDriver) -> int | None:
    return getattr(driver, "retractions", None)


def press_of(contact_force_n: float, force_limit_n: float) -> float:
    """Return the force at which the approach of a take ends [N]."""
    return min(_PRESS * contact_force_n, _PRESS_SHARE * force_limit_n)


class _Motion:
    """Moves the base behind the guard, and records one row a millisecond."""

    def __init__(self, driver: AfmDriver, limits: SafetyParams, recorder: Recorder, clock: Clock) -> None:
        self._driver, self._limits, self._recorder, self._clock = driver, limits, recorder, clock
        self._guard = TipGuard(limits)
        self._force_n, self._lost = 0.0, False
        self.records = True

    def begin(self, number: int, waits_at_m: float | None = None) -> bool:
        """Ask the person for a step and begin it; return whether the base went to waits_at_m [m] during the question.

        Raises:
            _StoppedError: The person declined the step.
        """
        went = [False]

        def idle() -> None:
            went[0] = waits_at_m is not None
            self.tick(self._guard.base_m if waits_at_m is None else waits_at_m)

        self.records = False
        if not self._recorder.wanted(number, idle):
            raise _StoppedError(f"the step {STEPS[number].name} was declined")
        self.records = True
        self._recorder.begin(number)
        return went[0]

    def tick(self, reference_m: float | None) -> AfmSample:
        """Ask the guard for a base [m] (None: the safe one), apply the allowed one, record and return a sample.

        Raises:
            _StoppedError: The guard has stopped following the reference.
        """
        driver, recorder = self._driver, self._recorder
        if self.records:
            recorder.wait()
        else:
            self._clock.wait(self._clock.now_ns() + round(PERIOD_S * 1e9))
        guard, force_n, is_lost, followed = self._guard, self._force_n, self._lost, self._guard.follows
        if reference_m is None:
            base_m = guard.retract(PERIOD_S, force_n=force_n, is_lost=is_lost)
        else:
            base_m = guard.follow(reference_m, PERIOD_S, force_n=force_n, is_lost=is_lost)
        if driver.simulation is not None:
            driver.simulation.elapse(PERIOD_S)
        sample = driver.exchange(base_m)
        report = driver.report
        status, age_s, in_range = ("ok", 0.0, True) if report is None else (report[0], report.age_s, report.force_valid)
        self._force_n, self._lost = sample.force_n if in_range else math.nan, status == "lost"
        fresh = getattr(driver, "fresh", getattr(driver, "exchanges", recorder.ticks))
        if self.records:
            recorder.add(
                age_s, base_m, sample.base_m, sample.force_n, sample.bridge_voltage_v, fresh,
                STATUSES.index(status), in_range,
            )  # fmt: skip
        if followed and not guard.follows and reference_m is not None:
            text = "" if report is None or not self._lost else f": {report.text}"
            raise _StoppedError(f"{guard.reason} in the step {recorder.step.name}{text}")
        return sample

    def stand(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.tick(self._guard.base_m)

    def go(self, to_m: float) -> None:
        """Go to a base position [m], as fast as the guard allows."""
        while abs(self._guard.base_m - to_m) > 1e-15:
            self.tick(to_m)

    def approach(self, press_n: float, speed_m_per_s: float) -> float:
        """Move towards the sample until it presses with press_n [N]; return the base there [m]."""
        reference_m = self._guard.base_m
        while reference_m < self._limits.base_max_m:
            reference_m = min(reference_m + speed_m_per_s * PERIOD_S, self._limits.base_max_m)
            force_n = self.tick(reference_m).force_n
            if force_n >= press_n:
                return self._guard.base_m
            if force_n <= -_PULL_SHARE * self._limits.force_limit_n:
                raise _StoppedError(PULLED)
        raise _StoppedError(f"no surface was found up to a base of {self._limits.base_max_m:g} m")

    def steps_in_contact(self, contact_m: float, step_m: float, half_s: float) -> None:
        """Step away from the contact and back, at times that cover all phases of the instrument's own cycle."""
        self.go(contact_m)
        self.stand(half_s)
        for edge in range(_EDGES):
            self.go(contact_m - (step_m if edge % 2 == 0 else 0.0))
            self.stand(half_s + (7 * edge % 23) * PERIOD_S)

    def retract(self) -> None:
        """Request the safe state for one second, ignoring errors."""
        with contextlib.suppress(TelenanoError, EndedError):
            for _ in range(round(1.0 / PERIOD_S)):
                self.tick(None)

    def come_back(self) -> None:
        """Request the retracted tip until the instrument answers again, and for some samples more."""
        good = 0
        for _ in range(round(_BACK_S / PERIOD_S)):
            self.tick(None)
            # The count is long enough for a driver that has not noticed the loss yet.
            good = 0 if self._lost else good + 1
            if good > _GOOD:
                return

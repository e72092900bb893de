"""The motion of a minute by which a device that takes a force is judged, and its recording.

A row holds the report of the device's servo and the command that it had.
"""

from typing import NamedTuple

from telenano.extend.hands import Capabilities, Gate
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
from telenano_devices.impedance.coupling import ZERO, CouplingSettings, Vector
from telenano_devices.impedance.impedance_config import bounds_of
from telenano_devices.impedance.servo import ServoCommand, ServoLink, ServoSample

STANDARD_GRAVITY_M_PER_S2 = 9.80665
# The take begins with the first sample of the device, or after this time without one.
_FIRST_NS = 2_000_000_000
# Stiffness along z over that of the settings, one level after the other in the second half of the step *hold*.
LEVELS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
# Each of these levels begins with a reference that is off by this; the first half of the step has forces along x, y, z.
_NUDGE_M = 1e-3
# A device that gives more than this force [N] needs an independent stop, because a hand can no longer simply hold
# against it. In the take a device without one is driven with no more.
MOST_WITHOUT_STOP_N = 5.0
AXES = ("x", "y", "z")


STEPS = (
    Step("rest", 8.0, "put the handle down, or hold it still"),
    Step("slow", 12.0, "move slowly through the whole workspace: right and left, forward and back, up and down"),
    Step("fast", 8.0, "move quickly to and fro in all directions"),
    Step("right", 3.0, "push the handle to the right, and let it come back"),
    Step("forward", 3.0, "push the handle forward, away from you, and let it come back"),
    Step("up", 3.0, "lift the handle, and let it come back"),
    Step("button", 5.0, "press and let go of each button, one after the other", "without load"),
    Step(
        "hold",
        12.0,
        "hold the handle still: the device pushes in three directions, and then becomes stiffer",
        "with load",
    ),
    Step("cable", 6.0, "pull the cable of the device out, wait for two seconds, and put it in again", "with load"),
)
MASS_STEP = Step("mass", 6.0, "hang the mass at the handle, and take your hands off", "with load")
# The largest number of different fault messages of a device that are kept.
_MOST_MESSAGES = 16

ROW = row_of(
    ("level", "f8"),
    ("place_m", "f8", 3),
    ("force_n", "f8", 3),
    ("asked_n", "f8", 3),
    ("gate", "i2"),
    ("counter", "i8"),
    ("late", "i8"),
    ("buttons", "i4"),
    ("orientation", "f8", 4),
    ("lost", "?"),
)


class Facts(NamedTuple):
    """The inputs of the checks besides the rows: the declared device, and the coupling with which it will be used.

    mass_kg: mass that was hung at the handle [kg], 0.0 for none. independent_stop: way to cut the power of the drives
    without the computer, empty if there is none. device_messages: faults that the device reported, each once. stopped:
    reason why the motion ended early.
    """

    device: Capabilities
    settings: CouplingSettings
    mass_kg: float = 0.0
    independent_stop: str = ""
    device_messages: tuple[str, ...] = ()
    stopped: str = ""

    @property
    def identity(self) -> str:
        return self.device.identity

    def tables(self) -> list[Table]:
        sentence = bounds_of(self.settings, self.device).sentence()
        text = (
            f"{sentence}. Set haptic_node.coupling.stiffness_n_per_m below the rendering stiffness that was found here,"
            " with a margin of your own."
        )
        return [
            Table("What was declared", "", self.device._asdict()),
            Table("The coupling", text, self.settings._asdict()),
        ]


def steps_of(mass_kg: float, pace: float = 1.0) -> tuple[Step, ...]:
    """Return the steps, with that of the mass if mass_kg is not 0; `pace` is a factor of their lengths."""
    steps = (*STEPS[:-1], MASS_STEP, STEPS[-1]) if mass_kg else STEPS
    return tuple(step._replace(seconds=step.seconds * pace) for step in steps)


def record_take(
    link: ServoLink, facts: Facts, steps: tuple[Step, ...], clock: Clock, guide: Guide = SILENT
) -> Take[Facts]:
    """Lead the person through the steps and record them; the link must be open, and stays open without force.

    If the motion ends early, the facts give the reason and the take has the rows recorded until then.

    Args:
        link: The device and its servo.
        facts: The facts known beforehand.
        steps: The steps from `steps_of`.
        clock: The clock of the servo.
        guide: The guide of the person.
    """
    guide.met(facts.identity)
    asker = _Asker(link, facts, clock)
    first_ns = clock.now_ns()
    while not asker.newest().taken_ns and clock.now_ns() - first_ns < _FIRST_NS:
        clock.wait(clock.now_ns() + round(PERIOD_S * 1e9))
    recorder = Recorder(steps, clock, guide)
    try:
        for number, step in enumerate(steps):
            if recorder.wanted(number, asker.idle):
                recorder.begin(number)
                _record_step(recorder, asker, step, facts.settings.silence_s)
    except (EndedError, TelenanoError) as error:
        facts = facts._replace(stopped=f"{error} (in the step {recorder.step.name})")
    asker.rest()
    return recorder.take(ROW, facts._replace(device_messages=tuple(asker.driver_messages)))


def _record_step(recorder: Recorder, asker: "_Asker", step: Step, silence_s: float) -> None:
    count = round(step.seconds / PERIOD_S)
    for index in range(count):
        recorder.wait()
        level, asked = asker.ask(step.name, index / count)
        sample = asker.newest()
        age_s = asker.age_s(sample)
        lost = bool(sample.error) or age_s > silence_s
        recorder.add(
            age_s, level, sample.position_m, sample.force_n, asked, sample.gate, sample.counter, sample.late,
            sample.buttons, sample.orientation, lost,
        )  # fmt: skip


class _Asker:
    """Sends commands to the servo, step by step, as a node would."""

    def __init__(self, link: ServoLink, facts: Facts, clock: Clock) -> None:
        settings = facts.settings
        most_n = settings.max_force_n if facts.independent_stop else min(settings.max_force_n, MOST_WITHOUT_STOP_N)
        self._push_n = min(1.0, 0.3 * most_n)
        # The force above which a reading must change has to be smaller than the force of a push.
        frozen_n = min(settings.frozen_force_n, 0.5 * self._push_n)
        self._settings = settings._replace(max_force_n=most_n, frozen_force_n=frozen_n)
        self._link, self._clock = link, clock
        self._found = ServoSample()
        self._counter = self._arm_count = 0
        # Position of the hand when the device was last engaged.
        self._home: Vector | None = None
        self.driver_messages: dict[str, None] = {}

    def newest(self) -> ServoSample:
        """Let a period pass, and return the last sample of the servo."""
        self._found = self._link.newest(0.0, PERIOD_S) or self._found
        if self._found.error and len(self.driver_messages) < _MOST_MESSAGES:
            self.driver_messages[self._found.error] = None
        return self._found

    def age_s(self, sample: ServoSample) -> float:
        """Return the present age of a sample [s]."""
        return (self._clock.now_ns() - sample.taken_ns) * 1e-9

    def idle(self) -> None:
        """Let a millisecond pass without force."""
        self.rest()
        self.newest()
        self._clock.wait(self._clock.now_ns() + round(PERIOD_S * 1e9))

    def rest(self) -> None:
        """Command zero force, disengaged."""
        self._home = None
        self._send(ZERO, ZERO, False, self._settings)

    def ask(self, name: str, share: float) -> tuple[float, Vector]:
        """Send the command for a share (0 to 1) of a step; return the level of stiffness and the force sent [N]."""
        engaged = name in ("hold", "mass", "button", "cable") and self._found.gate <= Gate.ACTIVE + 1
        if Gate(self._found.gate).is_fault:
            # The fault has been recorded; arm again, because the rest of the minute is worth recording too.
            self._arm_count += 1
        if not engaged:
            self._home = None
        elif self._home is None:
            self._home = self._found.position_m
        level, force, place = 1.0, ZERO, self._home or ZERO
        if name == "hold" and share < 0.5:
            pushed = min(2, int(share * 6.0))
            size = self._push_n if 0.2 < share * 6.0 - pushed < 0.9 else 0.0
            force = (size * (pushed == 0), size * (pushed == 1), size * (pushed == 2))
        elif name == "hold":
            at = (share - 0.5) * 2.0 * len(LEVELS)
            level = LEVELS[min(len(LEVELS) - 1, int(at))]
            place = (place[0], place[1], place[2] + _NUDGE_M * (at - int(at) < 0.3))
        x, y, z = self._settings.stiffness_n_per_m
        settings = self._settings._replace(stiffness_n_per_m=(x, y, z * level))
        self._send(place, force, engaged, settings)
        return level, force if engaged else ZERO

    def _send(self, place_m: Vector, force_n: Vector, engaged: bool, settings: CouplingSettings) -> None:
        self._counter += 1
        self._link.send(
            ServoCommand(
                counter=self._counter,
                sent_ns=self._clock.now_ns(),
                position_m=place_m,
                velocity_m_per_s=ZERO,
                force_n=force_n,
                engaged=engaged,
                arm_count=self._arm_count,
                stop=False,
                settings=settings,
            )
        )

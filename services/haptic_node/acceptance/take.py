"""The motion of a minute that a device is judged by: its steps, and the recording of them.

A take holds one row a millisecond of what the servo of the device said, and what was asked of it. Nothing else is read
by the checks, so that a take can be judged again.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError
from services.haptic_node.coupling import FAULTS, GATE_ACTIVE, ZERO, CouplingSettings, Vector
from services.haptic_node.driver import Capabilities
from services.haptic_node.servo import ServoCommand, ServoLink, ServoSample
from services.numerics.acceptance import Step as Step
from services.numerics.acceptance import read_rows, save_rows

PERIOD_S = 1e-3
_PERIOD_NS = 1_000_000
# The take begins with the first sample of the device, or after so long without one.
_FIRST_NS = 2_000_000_000
# K over that of the settings, one after the other, for the step *hold*
LEVELS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
# Forces along x, y and z are the first half of that step; each level begins with a reference that is off by so much.
_NUDGE_M = 1e-3
# Above this force [N] a device without an independent stop is refused: a hand can no longer just hold against it. In
# the take it is driven with no more.
MOST_WITHOUT_STOP_N = 5.0
AXES = ("x", "y", "z")


STEPS = (
    Step("rest", 8.0, "put the handle down, or hold it still"),
    Step("slow", 12.0, "move slowly through the whole workspace: right and left, forward and back, up and down"),
    Step("fast", 8.0, "move quickly to and fro in all directions"),
    Step("right", 3.0, "push the handle to the right, and let it come back"),
    Step("forward", 3.0, "push the handle forward, away from you, and let it come back"),
    Step("up", 3.0, "lift the handle, and let it come back"),
    Step("hold", 12.0, "hold the handle still: the device pushes in three directions, and then becomes stiffer"),
    Step("button", 5.0, "press and let go of each button, one after the other"),
    Step("cable", 6.0, "pull the cable of the device out, wait for two seconds, and put it in again"),
)
MASS_STEP = Step("mass", 6.0, "hang the mass at the handle, and take your hands off")

_COLUMNS: dict[str, Any] = {
    "time_s": "f8",
    "step": "i2",
    "level": "f8",
    "place_m": ("f8", 3),
    "force_n": ("f8", 3),
    "asked_n": ("f8", 3),
    "age_s": "f8",
    "gate": "i2",
    "counter": "i8",
    "late": "i8",
    "buttons": "i4",
    "orientation": ("f8", 4),
    "lost": "?",
}
ROW = np.dtype([(name, *(kind if isinstance(kind, tuple) else (kind,))) for name, kind in _COLUMNS.items()])


class Take(NamedTuple):
    """A recording: a row of ROW each millisecond, the steps in order, and what was declared and said beforehand.

    mass_kg: of the mass that was hung at the handle, 0.0 for none. independent_stop: how the power of the drives can be
    cut without the computer, empty if it cannot.
    """

    rows: npt.NDArray[Any]
    steps: tuple[Step, ...]
    device: Capabilities
    settings: CouplingSettings
    mass_kg: float
    independent_stop: str

    def of(self, name: str) -> npt.NDArray[Any]:
        """Return the rows of a step; none if the take has no such step."""
        numbers = [number for number, step in enumerate(self.steps) if step.name == name]
        return self.rows[np.isin(self.rows["step"], numbers)]

    def save(self, path: Path) -> None:
        """Write the take as one file of numpy (.npz)."""
        facts = {
            "device": self.device._asdict(),
            "settings": self.settings._asdict(),
            "steps": self.steps,
            "mass_kg": self.mass_kg,
            "independent_stop": self.independent_stop,
        }
        save_rows(path, self.rows, facts)


def read_take(path: Path) -> Take:
    """Read a take.

    Raises:
        ConfigError: The file cannot be read, or is no take.
    """
    try:
        rows, facts = read_rows(path)
        if rows.dtype != ROW:
            raise ValueError("its rows have other columns")
        device = Capabilities(**{key: _tuples(value) for key, value in facts["device"].items()})
        settings = CouplingSettings(**{key: _tuples(value) for key, value in facts["settings"].items()})
        steps = tuple(Step(*step) for step in facts["steps"])
        return Take(rows, steps, device, settings, float(facts["mass_kg"]), str(facts["independent_stop"]))
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: is no take of `telenano device accept`: {error}") from error


def _tuples(value: Any) -> Any:
    return tuple(_tuples(part) for part in value) if isinstance(value, list) else value


def steps_of(mass_kg: float, pace: float = 1.0) -> tuple[Step, ...]:
    """Return the steps, with that of the mass if there is one; pace stretches or shortens them all."""
    steps = (*STEPS[:-1], MASS_STEP, STEPS[-1]) if mass_kg else STEPS
    return tuple(step._replace(seconds=step.seconds * pace) for step in steps)


def record_take(
    link: ServoLink,
    settings: CouplingSettings,
    steps: tuple[Step, ...],
    *,
    now_ns: Callable[[], int],
    wait: Callable[[int], None] = lambda deadline_ns: None,
    say: Callable[[Step], None] = lambda step: None,
    mass_kg: float = 0.0,
    independent_stop: str = "",
) -> Take:
    """Lead through the steps and record them; the link is open, and stays so.

    Args:
        link: The device and its servo.
        settings: The coupling with which the device is to be used.
        steps: Those of `steps_of`.
        now_ns: The monotonic clock of the servo [ns]; a simulated device has its own.
        wait: Waits until a time of that clock [ns]; a simulated device lets the time pass itself.
        say: Tells the person of each step as it begins.
        mass_kg: Of the mass that is hung at the handle [kg]; 0.0 for none.
        independent_stop: How the drives can be stopped without the computer; empty if they cannot.
    """
    most_n = settings.max_force_n if independent_stop else min(settings.max_force_n, MOST_WITHOUT_STOP_N)
    # What a reading that stands still is found by is less than the force of a push.
    frozen_n = min(settings.frozen_force_n, 0.5 * _push_n(most_n))
    asker = _Asker(link, settings._replace(max_force_n=most_n, frozen_force_n=frozen_n), now_ns)
    rows = list(_rows(asker, steps, now_ns, wait, say))
    return Take(np.array(rows, ROW), steps, link.capabilities, settings, mass_kg, independent_stop)


def _push_n(most_n: float) -> float:
    """Return the force of a push in the step *hold*, for the greatest one [N]."""
    return min(1.0, 0.3 * most_n)


def _rows(
    asker: "_Asker",
    steps: tuple[Step, ...],
    now_ns: Callable[[], int],
    wait: Callable[[int], None],
    say: Callable[[Step], None],
) -> Iterator[tuple[Any, ...]]:
    begun_ns, tick = now_ns(), 0
    while not asker.newest().taken_ns and now_ns() - begun_ns < _FIRST_NS:
        wait(now_ns() + _PERIOD_NS)
    begun_ns = now_ns()
    for number, step in enumerate(steps):
        say(step)
        count = round(step.seconds / PERIOD_S)
        for index in range(count):
            tick += 1
            wait(begun_ns + round(tick * PERIOD_S * 1e9))
            level, asked = asker.ask(step.name, index / count)
            found = asker.newest()
            age_s = (now_ns() - found.taken_ns) * 1e-9
            yield (
                tick * PERIOD_S,
                number,
                level,
                found.position_m,
                found.force_n,
                asked,
                age_s,
                found.gate,
                found.counter,
                found.late,
                found.buttons,
                found.orientation,
                bool(found.error) or age_s > asker.settings.silence_s,
            )


class _Asker:
    """Commands for the servo, step by step, as a node would send them."""

    def __init__(self, link: ServoLink, settings: CouplingSettings, now_ns: Callable[[], int]) -> None:
        self.settings, self._link, self._now_ns = settings, link, now_ns
        self._found = ServoSample()
        self._counter = self._arm_count = 0
        # where the hand was when the device was engaged last
        self._home: Vector | None = None

    def newest(self) -> ServoSample:
        """Let a period pass, and return what the servo said last."""
        self._found = self._link.newest(0.0, PERIOD_S) or self._found
        return self._found

    def ask(self, name: str, share: float) -> tuple[float, Vector]:
        """Send the command for a place in a step; return the level of stiffness and the force that is asked for."""
        engaged = name in ("hold", "mass", "button", "cable") and self._found.gate <= GATE_ACTIVE + 1
        if self._found.gate in FAULTS:
            # what is refused has been recorded; the rest of the minute is worth recording as well
            self._arm_count += 1
        if not engaged:
            self._home = None
        elif self._home is None:
            self._home = self._found.position_m
        level, force, place = 1.0, ZERO, self._home or ZERO
        if name == "hold" and share < 0.5:
            pushed = min(2, int(share * 6.0))
            size = _push_n(self.settings.max_force_n) if 0.2 < share * 6.0 - pushed < 0.9 else 0.0
            force = (size * (pushed == 0), size * (pushed == 1), size * (pushed == 2))
        elif name == "hold":
            at = (share - 0.5) * 2.0 * len(LEVELS)
            level = LEVELS[min(len(LEVELS) - 1, int(at))]
            place = (place[0], place[1], place[2] + _NUDGE_M * (at - int(at) < 0.3))
        x, y, z = self.settings.stiffness_n_per_m
        settings = self.settings._replace(stiffness_n_per_m=(x, y, z * level))
        self._counter += 1
        self._link.send(
            ServoCommand(
                counter=self._counter,
                sent_ns=self._now_ns(),
                position_m=place,
                velocity_m_per_s=ZERO,
                force_n=force,
                engaged=engaged,
                arm_count=self._arm_count,
                stop=False,
                settings=settings,
            )
        )
        return level, force if engaged else ZERO

"""Judging a device from one recording, a take: the steps of a motion, a row a millisecond, a verdict for each check.

Nothing but rows, steps and facts is read by the checks, so that a take can be judged again from its file.
"""

import json
import time
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any, Generic, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from telenano.files import open_regular
from telenano.wire import ConfigError

PERIOD_S = 1e-3
# A take of two minutes has a third of this; nothing larger is unpacked from a file of somebody else.
_MOST_BYTES = 64 * 2**20
Load = Literal["read only", "without load", "with load"]
LOADS: tuple[Load, ...] = ("read only", "without load", "with load")
Result = Literal["pass", "fail", "retake", "cannot say"]
Rows = npt.NDArray[Any]


class Step(NamedTuple):
    """A step of the motion: its name, how long it takes [s], what the person is asked to do, and what is driven."""

    name: str
    seconds: float
    prompt: str
    load: Load = "read only"


class EndedError(Exception):
    """A person has ended the motion; the message says how."""


class Guide(NamedTuple):
    """How a person is led through a motion; the defaults show nothing and ask nothing.

    met: is told who the device is before anything moves. say: is told of each step as it begins. ask: returns whether a
    step is wanted; the function that it gets lets a millisecond pass with the device at rest. poll: is called each
    millisecond. waited: is told how late each one was [s]. Each may raise EndedError, which ends the motion with the
    device at rest.
    """

    say: Callable[[Step], None] = lambda step: None
    ask: Callable[[Step, Callable[[], None]], bool] = lambda step, idle: True
    poll: Callable[[], None] = lambda: None
    met: Callable[[str], None] = lambda identity: None
    waited: Callable[[float], None] = lambda late_s: None


SILENT = Guide()


class Verdict(NamedTuple):
    """What a check found: the result, what was measured, and what is wanted."""

    check: str
    result: Result
    found: str
    wanted: str


class Table(NamedTuple):
    """A part of the page: its heading, a sentence or nothing, and values by name."""

    heading: str
    text: str
    values: Mapping[str, Any]


class Facts(Protocol):
    """What the checks need besides the rows: a NamedTuple of plain values, and of NamedTuples of those."""

    @property
    def identity(self) -> str:
        """Return who the device is, in words."""

    def tables(self) -> list[Table]:
        """Return what the page says of the device."""

    def _asdict(self) -> dict[str, Any]: ...


F = TypeVar("F", bound=Facts)


class Take(NamedTuple, Generic[F]):
    """A recording: a row each millisecond, the steps in order, and what was declared and reported beforehand."""

    rows: Rows
    steps: tuple[Step, ...]
    facts: F

    @property
    def seconds(self) -> float:
        """Return how long the motion took [s]."""
        return round(float(self.rows["time_s"].max(initial=0.0)), 3)

    def of(self, name: str) -> Rows:
        """Return the rows of a step; none if the take has no such step."""
        numbers = [number for number, step in enumerate(self.steps) if step.name == name]
        rows: Rows = self.rows[np.isin(self.rows["step"], numbers)]
        return rows

    def save(self, path: Path | IO[bytes]) -> None:
        """Write the take as one file of numpy (.npz)."""
        facts = {key: one._asdict() if hasattr(one, "_asdict") else one for key, one in self.facts._asdict().items()}
        np.savez_compressed(path, rows=self.rows, facts=json.dumps({**facts, "steps": self.steps}))


class Kind(NamedTuple, Generic[F]):
    """What is judged in one way: the type of its rows, its facts by what a file has of them, and its checks in order.

    A check has its name, the function that judges a take, what is wanted, and the steps that it reads, none for all.
    `pass` and `fail` are of the device, `retake` asks for the motion once more, and `cannot say` names what is missing.
    say_what_is_missing: whether the checks themselves judge a take in which a step of theirs was not made.
    """

    row: np.dtype[Any]
    facts_of: Callable[..., F]
    checks: tuple[tuple[str, Callable[[Take[F]], tuple[Result, str]], str, tuple[str, ...]], ...]
    say_what_is_missing: bool = False

    def judge(self, take: Take[F]) -> list[Verdict]:
        """Return the verdict of every check, in order; one whose step was not made asks for it."""
        return [Verdict(name, *self._found(take, check, steps), wanted) for name, check, wanted, steps in self.checks]

    def load_of(self, take: Take[F], name: str) -> Load:
        """Return the least that was driven when a check of this name had all that it reads."""
        needed = next((steps for check, _, _, steps in self.checks if check == name), ())
        loads: list[Load] = [step.load for step in take.steps if step.name in needed]
        return max(loads, key=LOADS.index, default=LOADS[0])

    def _found(
        self, take: Take[F], check: Callable[[Take[F]], tuple[Result, str]], steps: tuple[str, ...]
    ) -> tuple[Result, str]:
        asked = {step.name for step in take.steps}
        missing = [name for name in steps if name in asked and not len(take.of(name))]
        if not len(take.rows) or (missing and not self.say_what_is_missing):
            return "retake", f"the step {missing[0]} was not made" if missing else "no step was made"
        return check(take)


def overall(verdicts: list[Verdict]) -> Result:
    """Return `fail` if one check fails, else `retake` if one asks for it, else `pass`."""
    results = {verdict.result for verdict in verdicts}
    for result in ("fail", "retake"):
        if result in results:
            return result
    return "pass"


def read_take(path: Path, *kinds: Kind[Any]) -> tuple[Kind[Any], Take[Any]]:
    """Return a take, and of which of these kinds it is.

    Raises:
        ConfigError: The file cannot be read, or is no take of such a kind.
    """
    try:
        with open_regular(path) as file:
            return take_of(file, *kinds)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: is no take of `telenano device accept`: {error}") from error


def take_of(file: IO[bytes], *kinds: Kind[Any]) -> tuple[Kind[Any], Take[Any]]:
    """Return a take from an open file that can be sought in, and of which of these kinds it is.

    Raises:
        ValueError: It is no take of such a kind, is damaged, or is larger than a take.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            if (stated := sum(member.file_size for member in archive.infolist())) > _MOST_BYTES:
                raise ValueError(f"it has {stated} bytes, and a take at most {_MOST_BYTES}")
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            rows, facts = arrays["rows"], dict(_tuples(json.loads(str(arrays["facts"]))))
        kind = next((kind for kind in kinds if kind.row == rows.dtype), None)
        if kind is None or rows.ndim != 1 or not len(rows):
            raise ValueError("it has other columns or no rows")
        steps = tuple(Step(*step) for step in facts.pop("steps"))
        return kind, Take(rows, steps, kind.facts_of(**facts))
    # damage may lead numpy, zipfile and zlib anywhere
    except Exception as error:
        raise ValueError(str(error)) from error


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(one) for key, one in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


class Clock(NamedTuple):
    """A monotonic clock [ns], and what waits until a time of it; a simulated device has its own."""

    now_ns: Callable[[], int]
    wait: Callable[[int], None] = lambda deadline_ns: None


MACHINE = Clock(time.monotonic_ns, lambda deadline_ns: time.sleep(max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9)))


class Recorder:
    """The rows of a take as it continues, each at a whole number of milliseconds of a clock."""

    def __init__(self, steps: tuple[Step, ...], clock: Clock, guide: Guide) -> None:
        self.rows: list[tuple[Any, ...]] = []
        self.ticks, self.step = 0, steps[0]
        self._steps, self._clock, self._guide = steps, clock, guide
        self._number, self._begun_ns = 0, clock.now_ns()

    def wanted(self, number: int, idle: Callable[[], None]) -> bool:
        """Ask whether a step is wanted; the time of the question is not one of the motion.

        Args:
            number: Of the step.
            idle: Lets a millisecond pass with the device at rest.
        """
        before_ns = self._clock.now_ns()
        answer = self._guide.ask(self._steps[number], idle)
        self._begun_ns += self._clock.now_ns() - before_ns
        return answer

    def begin(self, number: int) -> None:
        """Begin a step, and tell the person of it."""
        self._number, self.step = number, self._steps[number]
        self._guide.say(self.step)

    def wait(self, periods: int = 1) -> None:
        """Wait until this number of milliseconds after the last of these times."""
        self._guide.poll()
        self.ticks += periods
        due_ns = self._begun_ns + round(self.ticks * PERIOD_S * 1e9)
        self._clock.wait(due_ns)
        self._guide.waited((self._clock.now_ns() - due_ns) * 1e-9)

    def add(self, age_s: float, *values: Any) -> None:
        """Record the age of the sample [s], and what the kind has besides, at the time that was waited for."""
        self.rows.append((self.ticks * PERIOD_S, self._number, age_s, *values))

    def take(self, row: np.dtype[Any], facts: F) -> Take[F]:
        """Return what was recorded."""
        return Take(np.array(self.rows, row), self._steps, facts)


def row_of(*columns: Any) -> np.dtype[Any]:
    """Return the type of the rows of a kind: time and age of the sample [s], number of the step, its own columns."""
    return np.dtype([("time_s", "f8"), ("step", "i2"), ("age_s", "f8"), *columns])


# The checks of both kinds of device find the following in the same way.


def passes(good: bool) -> Result:
    """Return the result of a check that can only pass or fail."""
    return "pass" if good else "fail"


def median_age(rows: Rows, most_s: float) -> tuple[Result, str]:
    """Judge how old samples are, in the median."""
    if not len(rows):
        return "retake", "there are no rows"
    p50, p99 = np.percentile(rows["age_s"], (50.0, 99.0))
    return passes(p50 <= most_s), f"{1e3 * p50:.2f} ms, 99 %: {1e3 * p99:.2f} ms"


def noise(values: Rows | str, most: float, text: str, scale: float) -> tuple[Result, str]:
    """Judge the standard deviation of values at rest, shape (n,) or (n, axes): that of the worst window and axis.

    Each window is half a second, so that a drift does not count.

    Args:
        values: What was read, or why there is nothing to judge.
        most: The most that passes, in the unit of the values.
        text: How what was found is written, such as `{:.1f} um`.
        scale: By which it is multiplied for that.
    """
    if isinstance(values, str):
        return "retake", values
    windows = np.array_split(values, max(1, len(values) // 500))
    greatest = max(float(window.std(axis=0).max()) for window in windows)
    return passes(greatest <= most), f"{text.format(scale * greatest)}, one sigma"


def drift(values: Rows | str, most: float, text: str, scale: float) -> tuple[Result, str]:
    """Judge how far the means of both halves lie apart, on the worst axis; the arguments are those of `noise`."""
    if isinstance(values, str):
        return "retake", values
    half = len(values) // 2
    greatest = float(np.abs(values[half:].mean(axis=0) - values[:half].mean(axis=0)).max())
    return passes(greatest <= most), f"{text.format(scale * greatest)} between the halves of the step"

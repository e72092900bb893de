"""Judging a device from one recording, a take: the steps of a motion, one row a millisecond, a verdict for each check.

The checks read nothing but rows, steps and facts, so that a take can be judged again from its file.
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
# The largest take that is unpacked from a foreign file; a take of two minutes has a third of this.
_MOST_BYTES = 64 * 2**20
Load = Literal["read only", "without load", "with load"]
LOADS: tuple[Load, ...] = ("read only", "without load", "with load")
Result = Literal["pass", "fail", "retake", "cannot say"]
Rows = npt.NDArray[Any]


class Step(NamedTuple):
    """A step of the motion: its name, its length [s], the request to the person, and how the device is driven."""

    name: str
    seconds: float
    prompt: str
    load: Load = "read only"


class EndedError(Exception):
    """The person has ended the motion; the message says how."""


class Guide(NamedTuple):
    """Functions that lead a person through a motion; the defaults show nothing and ask nothing.

    met: gets the identity of the device before anything moves. say: gets each step as it begins. ask: returns whether
    the person wants a step; its second argument lets a millisecond pass with the device at rest. poll: is called each
    millisecond. waited: gets the lateness of each one [s]. Each may raise EndedError, which ends the motion with the
    device at rest.
    """

    say: Callable[[Step], None] = lambda step: None
    ask: Callable[[Step, Callable[[], None]], bool] = lambda step, idle: True
    poll: Callable[[], None] = lambda: None
    met: Callable[[str], None] = lambda identity: None
    waited: Callable[[float], None] = lambda late_s: None


SILENT = Guide()


class Verdict(NamedTuple):
    """The verdict of a check: its name, the result, the finding, and the requirement."""

    check: str
    result: Result
    found: str
    wanted: str


class Table(NamedTuple):
    """A table of the page: its heading, a sentence or an empty text, and values by name."""

    heading: str
    text: str
    values: Mapping[str, Any]


class Facts(Protocol):
    """The inputs of the checks besides the rows: a NamedTuple of plain values, and of NamedTuples of those."""

    @property
    def identity(self) -> str:
        """Return the identity of the device in words."""

    def tables(self) -> list[Table]:
        """Return the tables of the page about the device."""

    def _asdict(self) -> dict[str, Any]: ...


F = TypeVar("F", bound=Facts)


class Take(NamedTuple, Generic[F]):
    """A recording: a row each millisecond, the steps in order, and the facts of the device."""

    rows: Rows
    steps: tuple[Step, ...]
    facts: F

    @property
    def seconds(self) -> float:
        """Return the duration of the motion [s]."""
        return round(float(self.rows["time_s"].max(initial=0.0)), 3)

    def of(self, name: str) -> Rows:
        """Return the rows of a step; an empty array if the take has no such step."""
        numbers = [number for number, step in enumerate(self.steps) if step.name == name]
        rows: Rows = self.rows[np.isin(self.rows["step"], numbers)]
        return rows

    def save(self, path: Path | IO[bytes]) -> None:
        """Write the take as one NumPy file (.npz)."""
        facts = {key: one._asdict() if hasattr(one, "_asdict") else one for key, one in self.facts._asdict().items()}
        np.savez_compressed(path, rows=self.rows, facts=json.dumps({**facts, "steps": self.steps}))


class Kind(NamedTuple, Generic[F]):
    """A kind of take: the type of its rows, the function that makes its facts from a file, and its checks in order.

    A check has a name, the function that judges a take, the requirement in words, and the steps that it reads, empty
    for all. `pass` and `fail` concern the device, `retake` asks for the motion again, and `cannot say` names what is
    missing. say_what_is_missing: whether a check itself judges a take in which one of its steps was not made.
    """

    row: np.dtype[Any]
    facts_of: Callable[..., F]
    checks: tuple[tuple[str, Callable[[Take[F]], tuple[Result, str]], str, tuple[str, ...]], ...]
    say_what_is_missing: bool = False

    def judge(self, take: Take[F]) -> list[Verdict]:
        """Return the verdicts of all checks, in order; a check whose step was not made asks for a retake."""
        return [Verdict(name, *self._found(take, check, steps), wanted) for name, check, wanted, steps in self.checks]

    def load_of(self, take: Take[F], name: str) -> Load:
        """Return the strongest load (see `LOADS`) among the steps that the check of this name reads."""
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
    """Return `fail` if any check fails, else `retake` if any asks for it, else `pass`."""
    results = {verdict.result for verdict in verdicts}
    for result in ("fail", "retake"):
        if result in results:
            return result
    return "pass"


def read_take(path: Path, *kinds: Kind[Any]) -> tuple[Kind[Any], Take[Any]]:
    """Return the kind of the take in a file, one of `kinds`, and the take.

    Raises:
        ConfigError: The file cannot be read, or is no take of such a kind.
    """
    try:
        with open_regular(path) as file:
            return take_of(file, *kinds)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: is not a take of `telenano device accept`: {error}") from error


def take_of(file: IO[bytes], *kinds: Kind[Any]) -> tuple[Kind[Any], Take[Any]]:
    """Return the kind of the take in an open seekable file, one of `kinds`, and the take.

    Raises:
        ValueError: The file is no take of such a kind, is damaged, or is larger than a take may be.
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
    # A damaged file can make numpy, zipfile and zlib raise anything.
    except Exception as error:
        raise ValueError(str(error)) from error


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _tuples(one) for key, one in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


class Clock(NamedTuple):
    """A monotonic clock [ns], and the function that waits until a time of it; a simulated device has its own."""

    now_ns: Callable[[], int]
    wait: Callable[[int], None] = lambda deadline_ns: None


MACHINE = Clock(time.monotonic_ns, lambda deadline_ns: time.sleep(max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9)))


class Recorder:
    """Collects the rows of a take, each at a whole number of milliseconds of a clock."""

    def __init__(self, steps: tuple[Step, ...], clock: Clock, guide: Guide) -> None:
        self.rows: list[tuple[Any, ...]] = []
        self.ticks, self.step = 0, steps[0]
        self._steps, self._clock, self._guide = steps, clock, guide
        self._number, self._begun_ns = 0, clock.now_ns()

    def wanted(self, number: int, idle: Callable[[], None]) -> bool:
        """Return whether the person wants a step; the time of the question does not count as time of the motion.

        Args:
            number: The number of the step.
            idle: The function that lets a millisecond pass with the device at rest.
        """
        before_ns = self._clock.now_ns()
        answer = self._guide.ask(self._steps[number], idle)
        self._begun_ns += self._clock.now_ns() - before_ns
        return answer

    def begin(self, number: int) -> None:
        """Begin a step, and announce it to the person."""
        self._number, self.step = number, self._steps[number]
        self._guide.say(self.step)

    def wait(self, periods: int = 1) -> None:
        """Wait until this number of milliseconds after the time of the last call."""
        self._guide.poll()
        self.ticks += periods
        due_ns = self._begun_ns + round(self.ticks * PERIOD_S * 1e9)
        self._clock.wait(due_ns)
        self._guide.waited((self._clock.now_ns() - due_ns) * 1e-9)

    def add(self, age_s: float, *values: Any) -> None:
        """Record a row at the time last waited for: age of the sample [s], and the columns of the kind."""
        self.rows.append((self.ticks * PERIOD_S, self._number, age_s, *values))

    def take(self, row: np.dtype[Any], facts: F) -> Take[F]:
        """Return the take of the recorded rows."""
        return Take(np.array(self.rows, row), self._steps, facts)


def row_of(*columns: Any) -> np.dtype[Any]:
    """Return the dtype of the rows of a kind: time and age of the sample [s], number of the step, its own columns."""
    return np.dtype([("time_s", "f8"), ("step", "i2"), ("age_s", "f8"), *columns])


# The following functions are shared by the checks of all kinds of device.


def passes(good: bool) -> Result:
    """Return the result of a check that can only pass or fail."""
    return "pass" if good else "fail"


def median_age(rows: Rows, most_s: float) -> tuple[Result, str]:
    """Judge the median age of the samples against most_s [s]."""
    if not len(rows):
        return "retake", "there are no rows"
    p50, p99 = np.percentile(rows["age_s"], (50.0, 99.0))
    return passes(p50 <= most_s), f"{1e3 * p50:.2f} ms, 99 %: {1e3 * p99:.2f} ms"


def noise(values: Rows | str, most: float, text: str, scale: float) -> tuple[Result, str]:
    """Judge the standard deviation of values at rest, shape (n,) or (n, axes), in the worst window and axis.

    Each window is half a second long, so that a drift does not count.

    Args:
        values: The readings, or the reason why there is nothing to judge.
        most: The largest standard deviation that passes, in the unit of the values.
        text: The format of the finding, such as `{:.1f} um`.
        scale: The factor from the unit of the values to that of the text.
    """
    if isinstance(values, str):
        return "retake", values
    windows = np.array_split(values, max(1, len(values) // 500))
    greatest = max(float(window.std(axis=0).max()) for window in windows)
    return passes(greatest <= most), f"{text.format(scale * greatest)}, one sigma"


def drift(values: Rows | str, most: float, text: str, scale: float) -> tuple[Result, str]:
    """Judge the difference of the means of both halves, on the worst axis; the arguments are those of `noise`."""
    if isinstance(values, str):
        return "retake", values
    half = len(values) // 2
    greatest = float(np.abs(values[half:].mean(axis=0) - values[:half].mean(axis=0)).max())
    return passes(greatest <= most), f"{text.format(scale * greatest)} between the halves of the step"

"""Judging a device from one recording, a take: the steps of a motion, a verdict for each check, and the file of it."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError

Result = Literal["pass", "fail", "retake", "cannot say"]
Rows = npt.NDArray[Any]
T = TypeVar("T")


class Step(NamedTuple):
    """A step of the motion: its name, how long it takes [s], and what the person is asked to do."""

    name: str
    seconds: float
    prompt: str


class Verdict(NamedTuple):
    """What a check found: the result, what was measured, and what is wanted."""

    check: str
    result: Result
    found: str
    wanted: str


def passes(good: bool) -> Result:
    """Return the result of a check that can only pass or fail."""
    return "pass" if good else "fail"


def judged(take: T, checks: Sequence[tuple[str, Callable[[T], tuple[Result, str]], str]]) -> list[Verdict]:
    """Return the verdict of every check, in order; a check is its name, its function and what is wanted."""
    return [Verdict(name, *check(take), wanted) for name, check, wanted in checks]


def overall(verdicts: list[Verdict]) -> Result:
    """Return `fail` if one check fails, else `retake` if one asks for it, else `pass`."""
    results = {verdict.result for verdict in verdicts}
    for result in ("fail", "retake"):
        if result in results:
            return result
    return "pass"


def save_rows(path: Path, rows: Rows, facts: Mapping[str, Any]) -> None:
    """Write the rows of a take, and the facts that its checks need, as one file of numpy (.npz)."""
    np.savez_compressed(path, rows=rows, facts=json.dumps(facts))


def read_rows(path: Path) -> tuple[Rows, dict[str, Any]]:
    """Return the rows and the facts of a take.

    Raises:
        ConfigError: The file cannot be read, or is no take.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return file["rows"], dict(json.loads(str(file["facts"])))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: is no take of `telenano device accept`: {error}") from error

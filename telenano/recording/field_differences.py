"""Field by field comparison of messages, with a tolerance for each field in its own unit."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from telenano.wire.errors import ConfigError
from telenano.wire.patterns import fault_of_pattern, matches


class Tolerances:
    """Largest allowed difference of numeric fields, by glob of the dotted field name; zero by default.

    The unit is that of the field: `position_m=1e-12` allows a picometre in every component. `TOPIC:FIELD` applies to
    one topic only, because metres at the hand and at the tip differ by a factor of a million.
    """

    def __init__(self, limits: Mapping[str, float] | None = None) -> None:
        self._limits = dict(limits or {})

    @classmethod
    def parse(cls, texts: Sequence[str]) -> "Tolerances":
        """Parse texts of the form FIELD=VALUE; raise ConfigError for one that is malformed, negative or not finite."""
        limits: dict[str, float] = {}
        for text in texts:
            field, _, value = text.partition("=")
            try:
                limits[field] = float(value)
            except ValueError as error:
                raise ConfigError(f"tolerance {text}: is not of the form FIELD=VALUE") from error
            if fault := fault_of_pattern(field):
                raise ConfigError(f"tolerance: {fault}")
            if not (field and math.isfinite(limits[field]) and limits[field] >= 0.0):
                raise ConfigError(f"tolerance {text}: a finite value of 0 or more, in the unit of the field, is needed")
        return cls(limits)

    def on(self, topic: str) -> "Tolerances":
        limits: dict[str, float] = {}
        for name, limit in self._limits.items():
            limited, _, field = name.rpartition(":")
            if limited in ("", topic):
                limits[field] = max(limit, limits.get(field, 0.0))
        return Tolerances(limits)

    def of(self, field: str) -> float:
        """Return the tolerance of a field in its unit; the tolerance of a vector applies to its components."""
        stem = field.partition(".")[0]
        limits = [limit for name, limit in self._limits.items() if matches(field, name) or name == stem]
        return max(limits, default=0.0)

    def first_difference(
        self, left: Mapping[str, Any], right: Mapping[str, Any], ignore: Iterable[str] = ()
    ) -> "FieldDifference | None":
        """Return the first field in which two messages differ by more than its tolerance; None when they agree.

        Fields are plain values as `RecordedMessage.fields` returns them. `ignore` names top-level keys to skip.
        """
        skipped = frozenset(ignore)
        for key in (*left, *(key for key in right if key not in left)):
            if key not in skipped:
                difference = _difference(key, left.get(key, _ABSENT), right.get(key, _ABSENT), self)
                if difference is not None:
                    return difference
        return None


class FieldDifference(NamedTuple):
    """A field that differs: its dotted name and both values."""

    field: str
    left: Any
    right: Any

    @property
    def text(self) -> str:
        return f"{self.field}: {self.left!r} against {self.right!r}"


class _Absent:
    def __repr__(self) -> str:
        return "nothing"


_ABSENT = _Absent()


def _difference(name: str, left: Any, right: Any, tolerances: Tolerances) -> FieldDifference | None:
    if isinstance(left, Mapping) and isinstance(right, Mapping):
        for key in (*left, *(key for key in right if key not in left)):
            difference = _difference(f"{name}.{key}", left.get(key, _ABSENT), right.get(key, _ABSENT), tolerances)
            if difference is not None:
                return difference
        return None
    if isinstance(left, list | tuple) and isinstance(right, list | tuple) and len(left) == len(right):
        parts = (_difference(f"{name}.{i}", *pair, tolerances) for i, pair in enumerate(zip(left, right, strict=True)))
        return next((part for part in parts if part is not None), None)
    return None if _same(left, right, tolerances.of(name)) else FieldDifference(name, left, right)


def _same(left: Any, right: Any, tolerance: float) -> bool:
    if isinstance(left, float) and isinstance(right, float):
        # Without a tolerance the comparison is exact, so 0.0 and -0.0 differ.
        if tolerance == 0.0:
            return left == right and math.copysign(1.0, left) == math.copysign(1.0, right)
        return abs(left - right) <= tolerance
    if type(left) is not type(right):
        return False
    if tolerance > 0.0 and type(left) is int:
        return bool(abs(left - right) <= tolerance)
    return bool(left == right)

"""The state of a node in its journal: what the node declares, as bytes, and what these bytes were made of.

A node declares all that its outputs depend on besides its inputs in one struct, which it works on: `capture` returns
it, of the class `state_kind`, `restore` takes one, and `state_version` counts what its values have meant. So a field
that is added is kept without another line. The struct is encoded in the turn in which it is captured, and nothing else
holds it. Its fields are plain values, arrays, settings, messages, structs, and NamedTuples of these. What the settings
choose, such as a law, a sample or a program, keeps its state in a `Part`. The bytes hold the names of the fields and no
name of an attribute, class or module, so these may change without ending a re-run. Fields at the end of a struct that
have a default may be missing from the state of an older recording.
"""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple, Protocol, TypeVar, cast, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
from pydantic import BaseModel

from telenano.wire.errors import ConfigError, RecordingError
from telenano.wire.messages import Record

T = TypeVar("T")
# payload of an input by topic, source, seq, time of arrival [ns] and size [bytes]
FindInput = Callable[[str, str, int, int, int], bytes]


class Stateful(Protocol):
    """A node, as far as its state is concerned."""

    state_kind: Any
    state_version: int

    def capture(self) -> Any:
        """Return the state, None for a node that has none to restore. ValueError says why it has none now."""

    def restore(self, state: Any, find: FindInput) -> None:
        """Continue from a state; `find` returns the payloads of messages that the state only names."""


class Part(NamedTuple):
    """The state of a part that the settings choose: the names of its fields, and their values."""

    names: tuple[str, ...]
    values: Any

    def like(self, example: T) -> T:
        """Return the state as one of the kind of `example`, such as the state in which the part starts.

        Raises:
            ValueError: The state does not have the same fields.
        """
        _demand(self.names, _names(example), type(example))
        return cast(T, _made(self.values, example))

    def of_kind(self, kind: Any) -> Any:
        """Return the state as one of a class whose fields declare all kinds within; ValueError as in `like`."""
        _demand(self.names, _declared(kind), kind)
        return msgspec.convert(self.values, kind, dec_hook=_object)


def part(state: Any) -> Part:
    """Return the state of a part; a NamedTuple of plain values, arrays and NamedTuples needs no more than this."""
    return Part(_names(state), state)


def pack(node: Stateful) -> bytes:
    """Return the state of a node, empty where it has none to restore.

    Raises:
        ValueError: A part cannot be kept, which the message names; TypeError and OverflowError mean the same.
    """
    state = node.capture()
    if state is None:
        return b""
    return msgspec.msgpack.encode((node.state_version, _names(state), state), enc_hook=_plain)


def is_whole(packed: bytes) -> bool:
    """Return whether a state is there, and none of its bytes is missing."""
    try:
        return bool(packed) and msgspec.msgpack.decode(packed) is not None
    except (ValueError, RecursionError):
        return False


def _zeros(topic: str, src: str, seq: int, arrived_ns: int, size_bytes: int) -> bytes:
    return bytes(size_bytes)


def restore(node: Any, packed: bytes, find: FindInput = _zeros) -> None:
    """Put a node that was just built into a state; RecordingError when that is not one of this node and version."""
    try:
        version, names, values = msgspec.msgpack.decode(packed, type=tuple[int, tuple[str, ...], Any])
        if version != node.state_version:
            raise ValueError(f"it has version {version}, and this code reads version {node.state_version}")
        _demand(names, _declared(node.state_kind), node.state_kind)
        node.restore(msgspec.convert(values, node.state_kind, dec_hook=_object), find)
    except (ConfigError, ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise RecordingError(f"{node.context.key}: its state in the journal does not fit this code: {error}") from error


def _demand(recorded: tuple[str, ...], declared: tuple[str, ...], kind: Any) -> None:
    """Raise ValueError naming the fields that only one of two states has; a default at an end may be missing."""
    optional = _optional(kind)
    expected = tuple(name for name in declared if name in recorded or name not in optional)
    if recorded != expected:
        missing, surplus = ([x for x in a if x not in b] for a, b in ((expected, recorded), (recorded, expected)))
        named = {"lacks": missing, "has in addition": surplus}
        faults = [f"{word} {', '.join(names)}" for word, names in named.items() if names]
        raise ValueError("it " + (" and ".join(faults) or "has the same fields in another order"))
    _check_ends(frozenset(recorded), kind)


def _check_ends(recorded: frozenset[str], kind: Any, within: str = "") -> None:
    """Raise ValueError where a field is missing that is not at the end: the values have places, and no names."""
    missing = ""
    for field, hint in _hints(kind).items():
        name = within + field
        if name not in recorded:
            missing = missing or name
        elif missing:
            raise ValueError(f"it lacks {missing}, before {name}")
        else:
            for inner in _kinds(hint):
                _check_ends(recorded, inner, f"{name}.")


@cache
def _declared(kind: Any) -> tuple[str, ...]:
    """Return the names of the fields of a kind of state, with those of the kinds within, such as `guard.mode`."""
    return tuple(
        name
        for field, hint in _hints(kind).items()
        for name in (field, *(f"{field}.{inner}" for within in _kinds(hint) for inner in _declared(within)))
    )


def _names(state: Any) -> tuple[str, ...]:
    """Return the names of the fields of a state, where the values say what kind a field declared as Any is of."""
    kind: Any = type(state)
    if not _open_fields(kind):
        return _declared(kind)
    names: list[str] = []
    for field, hint in _hints(kind).items():
        is_open = field in _open_fields(kind)
        within = _names(getattr(state, field)) if is_open else [name for k in _kinds(hint) for name in _declared(k)]
        names += (field, *(f"{field}.{name}" for name in within))
    return tuple(names)


@cache
def _optional(kind: Any) -> frozenset[str]:
    """Return those names of `_declared` that recordings of before may lack: fields that were added with a default."""
    if not (hints := _hints(kind)):
        return frozenset()
    if issubclass(kind, msgspec.Struct):
        defaults = {field.name for field in msgspec.structs.fields(kind) if not field.required}
    else:
        defaults = set(kind._field_defaults)
    found: set[str] = set()
    for field, hint in hints.items():
        for within in _kinds(hint):
            names = _declared(within) if field in defaults else _optional(within)
            found |= {f"{field}.{inner}" for inner in names}
        found |= {field} & defaults
    return frozenset(found)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    # other tuples, plain values and arrays have no fields
    has_fields = isinstance(kind, type) and (hasattr(kind, "_fields") or issubclass(kind, msgspec.Struct))
    # A message is kept as it is on the wire.
    return get_type_hints(kind) if has_fields and kind is not Part and not issubclass(kind, Record) else {}


@cache
def _open_fields(kind: Any) -> tuple[str, ...]:
    """Return the fields that are declared as Any, or as a kind that has such fields."""
    return tuple(field for field, hint in _hints(kind).items() if hint is Any or _open_fields(hint))


def _kinds(hint: Any) -> Iterator[Any]:
    """Yield the kinds in a hint such as `tuple[Fate, ...] | None`."""
    if arguments := get_args(hint):
        for argument in arguments:
            yield from _kinds(argument)
    else:
        yield hint


def _made(values: Any, example: Any) -> Any:
    """Return values as one of the kind of `example`, which says what kind a field declared as Any is of."""
    kind: Any = type(example)
    if kind is tuple:
        return tuple(_made(value, like) for value, like in zip(values, example, strict=True))
    is_open = _open_fields(kind)
    if not is_open:
        return msgspec.convert(values, kind, dec_hook=_object)
    hints = list(_hints(kind).items())
    # The last fields may be missing where they have defaults.
    if not len(hints) - len(getattr(kind, "_field_defaults", ())) <= len(values) <= len(hints):
        raise ValueError(f"it has {len(values)} values for {len(hints)} fields")
    fields = zip(values, hints, strict=False)
    return kind(
        *(
            _made(value, getattr(example, field))
            if field in is_open
            else msgspec.convert(value, hint, dec_hook=_object)
            for value, (field, hint) in fields
        )
    )


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, BaseModel):
        # by the keys that a scenario has, which is what the model takes
        fields = type(value).model_fields
        return {field.alias or name: getattr(value, name) for name, field in fields.items()}
    raise TypeError(f"a {type(value).__name__} cannot be kept in a journal")


def _object(kind: Any, value: Any) -> Any:
    kind = get_origin(kind) or kind
    if kind is np.ndarray:
        dtype, shape, data = value
        # a copy can be written to, which compiled steps take for another type
        return np.frombuffer(data, dtype).reshape(shape).copy()
    if issubclass(kind, BaseModel):
        return kind.model_validate(value, strict=False)
    raise TypeError(f"a {kind.__name__} cannot be kept in a journal")

"""Encoding of a node's state for its journal, from which a re-run of the node continues.

A node keeps everything that its outputs depend on, besides its inputs, in one struct: `capture` returns it, of the
class `state_kind`, `restore` continues from one, and `state_version` rises when the meaning of its values changes. A
new field of the struct is thus saved without further code. The struct is encoded in the turn in which it is captured,
so it may be mutable. Its fields are plain values, arrays, settings, messages, structs, and NamedTuples of these. A
component chosen by the settings, such as a law, a sample or a program, keeps its state in a `Part`. The bytes contain
the names of the fields but none of a class or module, so these may be renamed without breaking a re-run. Fields with a
default at the end of a struct may be missing from the state in an older recording.
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
# Finds the payload of an input from topic, source, seq, time of arrival [ns] and size [bytes].
FindInput = Callable[[str, str, int, int, int], bytes]


class Stateful(Protocol):
    """Interface of a node whose state can be saved and restored."""

    state_kind: Any
    state_version: int

    def capture(self) -> Any:
        """Return the state; None if the node has none. Raise ValueError, with the reason, if it has none just now."""

    def restore(self, state: Any, find: FindInput) -> None:
        """Continue from a state; `find` returns the payloads of messages to which the state only refers."""


class Part(NamedTuple):
    """State of a component that the settings choose: the names of its fields, and their values."""

    names: tuple[str, ...]
    values: Any

    def like(self, example: T) -> T:
        """Return the state as an object of the type of `example`, such as the initial state of the component.

        Raises:
            ValueError: The state does not have the same fields.
        """
        _demand(self.names, _names(example), type(example))
        return cast(T, _made(self.values, example))

    def of_kind(self, kind: Any) -> Any:
        """Return the state as an object of a class that declares all nested types; raise ValueError as `like`."""
        _demand(self.names, _declared(kind), kind)
        return msgspec.convert(self.values, kind, dec_hook=_object)


def part(state: Any) -> Part:
    """Return the `Part` of a state; this is all that a NamedTuple of plain values, arrays and NamedTuples needs."""
    return Part(_names(state), state)


def pack(node: Stateful) -> bytes:
    """Return the encoded state of a node; empty bytes if it has none.

    Raises:
        ValueError: A value cannot be saved; TypeError and OverflowError mean the same.
    """
    state = node.capture()
    if state is None:
        return b""
    return msgspec.msgpack.encode((node.state_version, _names(state), state), enc_hook=_plain)


def is_whole(packed: bytes) -> bool:
    """Return whether an encoded state is not empty and complete."""
    try:
        return bool(packed) and msgspec.msgpack.decode(packed) is not None
    except (ValueError, RecursionError):
        return False


def _zeros(topic: str, src: str, seq: int, arrived_ns: int, size_bytes: int) -> bytes:
    return bytes(size_bytes)


def restore(node: Any, packed: bytes, find: FindInput = _zeros) -> None:
    """Restore the state of a newly built node; raise RecordingError if it does not fit this node and version."""
    try:
        version, names, values = msgspec.msgpack.decode(packed, type=tuple[int, tuple[str, ...], Any])
        if version != node.state_version:
            raise ValueError(f"it has version {version}, and this code reads version {node.state_version}")
        _demand(names, _declared(node.state_kind), node.state_kind)
        node.restore(msgspec.convert(values, node.state_kind, dec_hook=_object), find)
    except (ConfigError, ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise RecordingError(f"{node.context.key}: its state in the journal does not fit this code: {error}") from error


def _demand(recorded: tuple[str, ...], declared: tuple[str, ...], kind: Any) -> None:
    """Raise ValueError if the recorded fields differ from the declared ones; fields with a default may be missing."""
    optional = _optional(kind)
    expected = tuple(name for name in declared if name in recorded or name not in optional)
    if recorded != expected:
        missing, surplus = ([x for x in a if x not in b] for a, b in ((expected, recorded), (recorded, expected)))
        named = {"lacks": missing, "has in addition": surplus}
        faults = [f"{word} {', '.join(names)}" for word, names in named.items() if names]
        raise ValueError("it " + (" and ".join(faults) or "has the same fields in another order"))
    _check_ends(frozenset(recorded), kind)


def _check_ends(recorded: frozenset[str], kind: Any, within: str = "") -> None:
    """Raise ValueError if a missing field is not at the end: values are stored by position, without names."""
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
    """Return the field names of a state type, including those of nested types, such as `guard.mode`."""
    return tuple(
        name
        for field, hint in _hints(kind).items()
        for name in (field, *(f"{field}.{inner}" for within in _kinds(hint) for inner in _declared(within)))
    )


def _names(state: Any) -> tuple[str, ...]:
    """Return the field names of a state; the value of a field declared as Any determines its type."""
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
    """Return the names of `_declared` that older recordings may lack: the fields with a default."""
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
    # Only NamedTuples and structs have fields.
    has_fields = isinstance(kind, type) and (hasattr(kind, "_fields") or issubclass(kind, msgspec.Struct))
    # A message is saved in its wire form, so its fields are not listed.
    return get_type_hints(kind) if has_fields and kind is not Part and not issubclass(kind, Record) else {}


@cache
def _open_fields(kind: Any) -> tuple[str, ...]:
    """Return the fields that are declared as Any, or as a type that has such fields."""
    return tuple(field for field, hint in _hints(kind).items() if hint is Any or _open_fields(hint))


def _kinds(hint: Any) -> Iterator[Any]:
    """Yield the types in a hint such as `tuple[Fate, ...] | None`."""
    if arguments := get_args(hint):
        for argument in arguments:
            yield from _kinds(argument)
    else:
        yield hint


def _made(values: Any, example: Any) -> Any:
    """Return values as an object of the type of `example`, which determines the types of fields declared as Any."""
    kind: Any = type(example)
    if kind is tuple:
        return tuple(_made(value, like) for value, like in zip(values, example, strict=True))
    is_open = _open_fields(kind)
    if not is_open:
        return msgspec.convert(values, kind, dec_hook=_object)
    hints = list(_hints(kind).items())
    # The last fields may be missing if they have defaults.
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
        # By the keys of a scenario, which validation of the model expects.
        fields = type(value).model_fields
        return {field.alias or name: getattr(value, name) for name, field in fields.items()}
    raise TypeError(f"a {type(value).__name__} cannot be kept in a journal")


def _object(kind: Any, value: Any) -> Any:
    kind = get_origin(kind) or kind
    if kind is np.ndarray:
        dtype, shape, data = value
        # A copy, because frombuffer is read-only, which is another type for compiled steps.
        return np.frombuffer(data, dtype).reshape(shape).copy()
    if issubclass(kind, BaseModel):
        return kind.model_validate(value, strict=False)
    raise TypeError(f"a {kind.__name__} cannot be kept in a journal")

"""The state of a node as bytes: what has changed since it was built, to build it again and go on from there."""

import importlib
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import msgpack
import numpy as np
from pydantic import BaseModel

from presets.plugins import modules
from proto.errors import ConfigError, RecordingError

_PLAIN = (type(None), bool, int, float, str, bytes)
# of this project, and of the packages that extend it
_PACKAGES = ("proto.", "services.", *modules())
# half of what a message may hold
_LARGEST = 1 << 19

# payload of an input by topic, source, seq, time of arrival [ns] and size [bytes]
FindInput = Callable[[str, str, int, int, int], bytes]


class StateSnapshot:
    """Captures the state of a node as often as is asked.

    State is every plain value, NamedTuple, message, configuration and array that hangs on the node or on an object of
    this project that the node was built with; what was not replaced since then, such as parameters and tables, is left
    out: building the node again gives it. The context of the node belongs to the world, not to the node. An object
    whose state has other forms has `capture_state`, which gives plain values, and `restore_state`.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._context = node.context
        self._built: dict[tuple[str, ...], dict[str, Any]] = {}
        self._remember((), node)

    def capture(self) -> bytes:
        """Return the state; empty when it is too large or holds what has no form here, such as a live device."""
        try:
            state: bytes = msgpack.packb(self._changed((), self._node))
        except (TypeError, ValueError, OverflowError):
            return b""
        return state if len(state) <= _LARGEST else b""

    def _remember(self, path: tuple[str, ...], owner: Any) -> None:
        self._built[path] = dict(vars(owner))
        for name, value in vars(owner).items():
            if self._is_owner(value) and not hasattr(value, "capture_state"):
                self._remember((*path, name), value)

    def _is_owner(self, value: Any) -> bool:
        if value is self._context or value is self._context.clock or isinstance(value, BaseModel | tuple | type):
            return False
        return hasattr(value, "__dict__") and _is_known(type(value).__module__)

    def _changed(self, path: tuple[str, ...], owner: Any) -> dict[str, Any]:
        built = self._built[path]
        changed: dict[str, Any] = {}
        for name, value in vars(owner).items():
            if isinstance(value, _PLAIN):
                # always: plain values such as a deadline depend on when the node was built
                changed[name] = value
            elif (*path, name) in self._built and value is built[name]:
                changed[name] = ["parts", self._changed((*path, name), value)]
            elif name == "clock" and not path:
                continue
            elif hasattr(value, "capture_state") and name in built and value is built[name]:
                changed[name] = ["own", value.capture_state()]
            elif value is not built.get(name) or isinstance(value, set | list | dict | deque):
                changed[name] = _packed(value)
        return changed


def _zeros(topic: str, src: str, seq: int, arrived_ns: int, size_bytes: int) -> bytes:
    return bytes(size_bytes)


def restore(node: Any, state: bytes, find: FindInput = _zeros) -> None:
    """Put a node that was just built into a captured state; RecordingError when that is not one of this node.

    `find` gives the payloads of messages that the node had received and not yet forwarded: the state has their names.
    """
    try:
        _restore_parts(node, msgpack.unpackb(state, strict_map_key=False), find)
    except (
        ConfigError,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        IndexError,
        ImportError,
        msgpack.exceptions.UnpackException,
    ) as error:
        raise RecordingError(f"{node.context.key}: its state in the journal does not fit this code: {error}") from error


def _restore_parts(owner: Any, parts: Mapping[str, Any], find: FindInput) -> None:
    for name, value in parts.items():
        if isinstance(value, list) and value[0] == "parts":
            _restore_parts(vars(owner)[name], value[1], find)
        elif isinstance(value, list) and value[0] == "own":
            vars(owner)[name].restore_state(value[1], find)
        else:
            setattr(owner, name, _unpacked(value))


def _packed(value: Any) -> Any:
    if isinstance(value, _PLAIN):
        return value
    if isinstance(value, tuple):
        kind = _name_of(type(value)) if hasattr(value, "_fields") else ""
        return ["tuple", kind, [_packed(part) for part in value]]
    if isinstance(value, BaseModel):
        return ["model", _name_of(type(value)), {name: _packed(part) for name, part in value.__dict__.items()}]
    if isinstance(value, np.ndarray):
        return ["array", value.dtype.str, list(value.shape), value.tobytes()]
    if isinstance(value, list):
        return ["list", [_packed(part) for part in value]]
    if isinstance(value, deque):
        return ["deque", value.maxlen, [_packed(part) for part in value]]
    if isinstance(value, set | frozenset):
        return [type(value).__name__, [_packed(part) for part in sorted(value)]]
    if isinstance(value, dict):
        return ["dict", [[_packed(name), _packed(part)] for name, part in value.items()]]
    raise TypeError(f"a {type(value).__name__} has no form in the state of a node")


def _unpacked(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    form, *rest = value
    if form == "tuple":
        parts = [_unpacked(part) for part in rest[1]]
        # `_make` refuses another number of fields than the class has, also where the class has defaults
        return _named(rest[0])._make(parts) if rest[0] else tuple(parts)
    if form == "model":
        return _named(rest[0]).model_construct(**{name: _unpacked(part) for name, part in rest[1].items()})
    if form == "array":
        # a copy can be written to, which compiled steps take for another type
        return np.frombuffer(rest[2], dtype=rest[0]).reshape(rest[1]).copy()
    if form == "dict":
        return {_unpacked(name): _unpacked(part) for name, part in rest[0]}
    if form == "deque":
        return deque(map(_unpacked, rest[1]), rest[0])
    kinds: dict[str, Any] = {"list": list, "set": set, "frozenset": frozenset}
    return kinds[form](_unpacked(part) for part in rest[0])


def _is_known(module: str) -> bool:
    return f"{module}.".startswith(_PACKAGES)


def _name_of(kind: type) -> str:
    if not _is_known(kind.__module__):
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} is not of this project")
    return f"{kind.__module__}:{kind.__qualname__}"


def _named(name: str) -> Any:
    module, _, path = name.partition(":")
    found: Any = importlib.import_module(module) if _is_known(module) else None
    for part in path.split("."):
        found = getattr(found, part)
    # a recording comes from anywhere: it may name a kind of value, and nothing that could be called for its effect
    if not (isinstance(found, type) and issubclass(found, tuple | BaseModel)):
        raise TypeError(f"{name} is not a kind of state")
    return found

"""What a page may say to the server: one msgpack map a frame, checked before anything is done with it."""

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import msgpack

from proto.messages import Scalar

# raised when a page of an older build would misread what the server says, or the other way round
PROTOCOL = 1
LARGEST_FRAME = 1 << 16
COMMANDS = ("start", "stop", "arm", "set", "mark", "couple")
_MOST_PARAMETERS = 64
_MOST_TEXT = 256
_LONGEST_SHOWN_S = 1e6
_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")


class RequestError(Exception):
    """A frame is not what a page may send; the text says what would be right."""


class Hello(NamedTuple):
    """The first frame of a page: its token and the protocol that it was built for."""

    token: str
    protocol: int


class CommandRequest(NamedTuple):
    """A command to the nodes of the rig."""

    id: str
    command: str
    target: str
    parameters: dict[str, Scalar]


class EstopRequest(NamedTuple):
    """An emergency stop."""

    id: str


class TransportRequest(NamedTuple):
    """An action of the transport of a recording; `value` is a place [s] or a rate."""

    id: str
    action: str
    value: float


class DocumentRequest(NamedTuple):
    """A question for what happened in the whole of a recording."""

    id: str


class PartRequest(NamedTuple):
    """A question for the curves of a part of a recording [s], in so many spans; every sample for 0."""

    id: str
    from_s: float
    to_s: float
    spans: int


class HandRequest(NamedTuple):
    """The force of the operator at the page [N], towards the sample; `held` is false when the hand lets go.

    across_n: that across the sample, x and y [N]; none from a page that only presses.
    """

    force_n: float
    held: bool
    across_n: tuple[float, float] = (0.0, 0.0)


class AnswerRequest(NamedTuple):
    """What a person answers to a cue of an experiment, and how long that had been shown [s]."""

    id: str
    cue: str
    values: dict[str, Scalar]
    shown_s: float


Request = (
    Hello
    | CommandRequest
    | EstopRequest
    | TransportRequest
    | HandRequest
    | DocumentRequest
    | PartRequest
    | AnswerRequest
)


def read_request(frame: bytes) -> Request:
    """Read a frame; RequestError says what is wrong with it."""
    if len(frame) > LARGEST_FRAME:
        raise RequestError(f"a frame has {len(frame)} bytes, {LARGEST_FRAME} are allowed")
    try:
        fields = msgpack.unpackb(frame, max_map_len=_MOST_PARAMETERS, max_array_len=0, max_str_len=4096, max_ext_len=0)
    except (ValueError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise RequestError("a frame is not one msgpack map") from error
    if not isinstance(fields, dict):
        raise RequestError("a frame is not a msgpack map")
    kind = fields.get("k")
    if kind == "hello":
        return Hello(_text(fields, "token"), _integer(fields, "protocol"))
    if kind == "command":
        command = _text(fields, "command")
        if command not in COMMANDS:
            raise RequestError(f"command {command!r}: unknown, the page may send {', '.join(COMMANDS)}")
        return CommandRequest(_id(fields), command, _text(fields, "target"), _parameters(fields))
    if kind == "estop":
        return EstopRequest(_id(fields))
    if kind == "transport":
        return TransportRequest(_id(fields), _text(fields, "action"), _float(fields, "value"))
    if kind == "document":
        return DocumentRequest(_id(fields))
    if kind == "part":
        spans = _integer(fields, "spans")
        return PartRequest(_id(fields), _float(fields, "from_s"), _float(fields, "to_s"), spans)
    if kind == "hand":
        x_n, y_n = (_float(fields, key) if key in fields else 0.0 for key in ("across_x_n", "across_y_n"))
        return HandRequest(_float(fields, "force_n"), fields.get("held") is True, (x_n, y_n))
    if kind == "experiment":
        shown_s = min(max(0.0, _float(fields, "shown_s")), _LONGEST_SHOWN_S)
        return AnswerRequest(_id(fields), _text(fields, "cue"), _parameters(fields, "values"), shown_s)
    raise RequestError(
        f"k is {str(kind)[:40]!r}: must be hello, command, estop, transport, hand, document, part or experiment"
    )


def _text(fields: Mapping[Any, Any], key: str) -> str:
    value = fields.get(key)
    if not isinstance(value, str) or len(value) > _MOST_TEXT:
        raise RequestError(f"{key}: must be a text of at most {_MOST_TEXT} characters")
    return value


def _id(fields: Mapping[Any, Any]) -> str:
    value = _text(fields, "id")
    if not _ID.fullmatch(value):
        raise RequestError("id: must have 1 to 64 of the characters A-Z a-z 0-9 _ -")
    return value


def _integer(fields: Mapping[Any, Any], key: str) -> int:
    value = fields.get(key)
    if type(value) is not int:
        raise RequestError(f"{key}: must be an integer")
    return value


def _float(fields: Mapping[Any, Any], key: str) -> float:
    value = fields.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RequestError(f"{key}: must be a finite number")
    return float(value)


def _parameters(fields: Mapping[Any, Any], name: str = "parameters") -> dict[str, Scalar]:
    value = fields.get(name, {})
    if not isinstance(value, dict):
        raise RequestError(f"{name}: must be a map")
    for key, scalar in value.items():
        number = isinstance(scalar, int | float)
        if (
            not isinstance(key, str)
            or not (number or isinstance(scalar, str))
            or (number and not math.isfinite(scalar))
        ):
            raise RequestError(f"{name}.{str(key)[:40]}: must be a finite number, true or false, or a text")
        if isinstance(scalar, int) and not -(2**63) <= scalar < 2**63:
            raise RequestError(f"{name}.{key[:40]}: an integer has 64 bits at most")
    return value

"""Messages of a Gwyscope as bytes and back: each is one serialised GwyObject named GS, without the magic of a file.

    "GS" NUL, size (uint32, little-endian), then items: key NUL, one letter for the type, value

Letters: b one byte, i int32, d float64, s text NUL, D uint32 count and this many float64. The type of a Python value
decides: bool b, int i, float d, str s, array D. It must be right, because a server ends on a type that it does not
expect. Source: NenoVision/GwyScope-Fork-Stabilizer, server 4.1.19, and gwyfile 0.3.0.
"""

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from telenano_devices.controllers.request_answer import LARGEST_BYTES, WireError

_NAME = b"GS\0"
_SIZE = struct.Struct("<I")
_HEADER = len(_NAME) + _SIZE.size
_NUMBERS = {"b": struct.Struct("<?"), "i": struct.Struct("<i"), "d": struct.Struct("<d")}
Message = Mapping[str, Any]


def encode(message: Message) -> bytes:
    """Return a message as bytes.

    Raises:
        TypeError: The protocol has no letter for the type of a value.
    """
    items = b"".join(key.encode() + b"\0" + _value(value) for key, value in message.items())
    return _NAME + _SIZE.pack(len(items)) + items


def _value(value: Any) -> bytes:
    if isinstance(value, bool):
        return b"b" + struct.pack("<?", value)
    if isinstance(value, int):
        return b"i" + struct.pack("<i", value)
    if isinstance(value, float):
        return b"d" + struct.pack("<d", value)
    if isinstance(value, str):
        return b"s" + value.encode() + b"\0"
    if isinstance(value, np.ndarray):
        return b"D" + _SIZE.pack(value.size) + value.astype("<f8").tobytes()
    raise TypeError(f"a {type(value).__name__} has no letter in a message of a Gwyscope")


def decode(frame: bytes) -> dict[str, Any]:
    """Return the items of a message.

    Raises:
        WireError: The bytes are no message, or an item has a type that Gwyscope does not send.
    """
    if cut(frame) != len(frame):
        raise WireError(f"a message of {len(frame)} bytes cannot be read: it is not of the length that it states")
    values, place = {}, _HEADER
    try:
        while place < len(frame):
            key, place = _text(frame, place)
            values[key], place = _item(frame, place)
    except (ValueError, KeyError, struct.error) as error:
        raise WireError(f"a message of {len(frame)} bytes cannot be read: {error}") from error
    return values


def _item(frame: bytes, place: int) -> tuple[Any, int]:
    """Return the value whose letter stands at `place`, and the index of the byte after it."""
    letter, place = frame[place : place + 1].decode("latin-1"), place + 1
    if letter == "s":
        return _text(frame, place)
    if letter == "D":
        (count,) = _SIZE.unpack_from(frame, place)
        place += _SIZE.size
        return np.frombuffer(frame, "<f8", count, place), place + 8 * count
    number = _NUMBERS[letter]
    return number.unpack_from(frame, place)[0], place + number.size


def _text(frame: bytes, place: int) -> tuple[str, int]:
    end = frame.index(b"\0", place)
    return frame[place:end].decode("utf-8", "replace"), end + 1


def cut(stream: bytes) -> int:
    """Return the length of the first message of a stream; see `request_answer.Cut`."""
    if stream[:_HEADER][: len(_NAME)] != _NAME[: len(stream)]:
        raise WireError(f"{stream[:8]!r} is not the beginning of a message of a Gwyscope")
    if len(stream) < _HEADER:
        return 0
    (size,) = _SIZE.unpack_from(stream, len(_NAME))
    if size > LARGEST_BYTES:
        raise WireError(f"a message of {size} bytes is longer than any of a Gwyscope")
    whole = _HEADER + int(size)
    return whole if len(stream) >= whole else 0

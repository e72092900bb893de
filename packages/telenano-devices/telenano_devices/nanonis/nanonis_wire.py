"""Messages of the TCP programming interface of Nanonis as bytes and back: header of 40 bytes, arguments; big-endian.

    command (32 bytes, ASCII, NUL), body size (int32), send a response (uint16), zero (uint16), body

An answer repeats the command, and its body has the return arguments and then an error block: status (uint32), length of
the text (int32), text. Letters of the layouts here: H uint16, i int32, I uint32, f float32, d float64, s text (int32
length, bytes), S array of texts (int32 bytes in all, int32 count, texts), n with a letter, such as nf: int32 count and
this many numbers, M matrix (int32 rows, int32 columns, float32 by rows). Texts and arrays state their own length, which
is therefore checked against the length of the message.
"""

import re
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from telenano_devices.controllers.request_answer import LARGEST_BYTES, WireError

HEADER = struct.Struct(">32siHH")
_ERROR = struct.Struct(">Ii")
_MOST_NAMES = 4096
_NAME = re.compile(rb"[A-Za-z0-9]+\.[A-Za-z0-9]+")
# Command: layout of its arguments, layout of its return values.
COMMANDS: dict[str, tuple[str, str]] = {
    "Signals.NamesGet": ("", "S"),
    "Signals.ValGet": ("i I", "f"),
    "Signals.ValsGet": ("ni I", "nf"),
    "Signals.RangeGet": ("i", "f f"),
    "ZCtrl.OnOffSet": ("I", ""),
    "ZCtrl.OnOffGet": ("", "I"),
    "ZCtrl.StatusGet": ("", "H"),
    "ZCtrl.ZPosSet": ("f", ""),
    "ZCtrl.ZPosGet": ("", "f"),
    "ZCtrl.SetpntSet": ("f", ""),
    "ZCtrl.SetpntGet": ("", "f"),
    "ZCtrl.GainSet": ("f f f", ""),
    "ZCtrl.GainGet": ("", "f f f"),
    "ZCtrl.LimitsEnabledSet": ("I", ""),
    "ZCtrl.LimitsEnabledGet": ("", "I"),
    "ZCtrl.LimitsSet": ("f f", ""),
    "ZCtrl.LimitsGet": ("", "f f"),
    "ZCtrl.TipLiftSet": ("f", ""),
    "ZCtrl.TipLiftGet": ("", "f"),
    "ZCtrl.SwitchOffDelaySet": ("f", ""),
    "ZCtrl.SwitchOffDelayGet": ("", "f"),
    "ZCtrl.WithdrawRateSet": ("f", ""),
    "ZCtrl.WithdrawRateGet": ("", "f"),
    "ZCtrl.Withdraw": ("I i", ""),
    "FolMe.XYPosSet": ("d d I", ""),
    "FolMe.XYPosGet": ("I", "d d"),
    "FolMe.SpeedSet": ("f I", ""),
    "FolMe.SpeedGet": ("", "f I"),
    "FolMe.Stop": ("", ""),
    "Scan.FrameSet": ("f f f f f", ""),
    "Scan.FrameGet": ("", "f f f f f"),
    "Scan.BufferSet": ("ni i i", ""),
    "Scan.BufferGet": ("", "ni i i"),
    "Scan.SpeedSet": ("f f f f H f", ""),
    "Scan.SpeedGet": ("", "f f f f H f"),
    "Scan.Action": ("H I", ""),
    "Scan.StatusGet": ("", "I"),
    "Scan.FrameDataGrab": ("I I", "s M I"),
    "SafeTip.OnOffSet": ("H", ""),
    "SafeTip.OnOffGet": ("", "H"),
    "SafeTip.PropsSet": ("H H f", ""),
    "SafeTip.PropsGet": ("", "H H f"),
    "SafeTip.SignalGet": ("", "f"),
    "Piezo.RangeGet": ("", "f f f"),
    "Util.AcqPeriodSet": ("f", ""),
    "Util.AcqPeriodGet": ("", "f"),
    "TCPLog.ChsSet": ("ni", ""),
    "TCPLog.OversamplSet": ("i", ""),
    "TCPLog.Start": ("", ""),
    "TCPLog.Stop": ("", ""),
    "TCPLog.StatusGet": ("", "H"),
}


class NanonisRefusalError(Exception):
    """The controller has answered with an error; the message is that of the controller."""


class Request(NamedTuple):
    """A request as a server reads it: the command as spelt, its packed arguments, and whether an answer is wanted."""

    command: str
    body: bytes
    answers: bool


def known(command: str) -> str | None:
    """Return a command in the spelling of `COMMANDS`, ignoring case as a server does; None if it is unknown."""
    return _SPELT.get(command.lower())


_SPELT = {name.lower(): name for name in COMMANDS}


def cut(stream: bytes) -> int:
    """Return the length of the first message of a stream; see `request_answer.Cut`."""
    if len(stream) < HEADER.size:
        return 0
    name, size, _, _ = HEADER.unpack_from(stream)
    if not 0 <= size <= LARGEST_BYTES or not _NAME.fullmatch(name.rstrip(b"\0")):
        raise WireError(f"{stream[:16]!r} is not the beginning of a message of Nanonis")
    whole = HEADER.size + int(size)
    return whole if len(stream) >= whole else 0


def request(command: str, *arguments: Any) -> bytes:
    """Return the bytes of a request that wants an answer."""
    body = pack(COMMANDS[command][0], arguments)
    return HEADER.pack(command.encode(), len(body), 1, 0) + body


def parse_request(frame: bytes) -> Request:
    """Return the request in a frame that `cut` has accepted."""
    name, _, answers, _ = HEADER.unpack_from(frame)
    return Request(name.rstrip(b"\0").decode("ascii"), frame[HEADER.size :], answers == 1)


def answer(command: str, returned: bytes, error: str = "") -> bytes:
    """Return the bytes of an answer: the command as it was spelt, packed return arguments, and the error block."""
    text = error.encode()
    body = returned + _ERROR.pack(1 if error else 0, len(text)) + text
    return HEADER.pack(command.encode(), len(body), 0, 0) + body


def returned(command: str, frame: bytes) -> list[Any]:
    """Return the return arguments of an answer.

    Raises:
        NanonisRefusalError: The controller reports an error.
        WireError: The answer is to another command, or does not have the layout of the command.
    """
    name = HEADER.unpack_from(frame)[0].rstrip(b"\0").decode("ascii", "replace")
    if name.lower() != command.lower():
        raise WireError(f"an answer to {name} came, {command} was asked")
    body, layout = frame[HEADER.size :], COMMANDS[command][1]
    # An error may come with return arguments, without them, or with eight bytes more.
    try:
        values, end = unpack(layout, body)
    except WireError:
        values, end = [], 0
        if _error_at(body, 0) is None:
            raise
    for start in dict.fromkeys((end, 0, end + 8)):
        error = _error_at(body, start)
        if error:
            raise NanonisRefusalError(error)
        if error is not None and start == end:
            return values
    raise WireError(f"an answer to {command} of {len(body)} bytes does not end with its error block")


def _error_at(body: bytes, start: int) -> str | None:
    """Return the text of an error block from `start` to the end of the body, empty for no error; None if it is none."""
    if start + _ERROR.size > len(body):
        return None
    status, size = _ERROR.unpack_from(body, start)
    if start + _ERROR.size + size != len(body) or status not in (0, 1):
        return None
    text = body[start + _ERROR.size :].decode("utf-8", "replace").strip()
    return text or ("an error without a text" if status else "")


def pack(layout: str, values: Sequence[Any]) -> bytes:
    """Return values as bytes, by a layout of the letters of this module."""
    return b"".join(_packed(letter, value) for letter, value in zip(layout.split(), values, strict=True))


def _packed(letter: str, value: Any) -> bytes:
    if letter == "s":
        text = str(value).encode()
        return struct.pack(">i", len(text)) + text
    if letter == "S":
        texts = b"".join(_packed("s", each) for each in value)
        return struct.pack(">ii", len(texts), len(value)) + texts
    if letter == "M":
        matrix = np.asarray(value, ">f4")
        return struct.pack(">ii", *matrix.shape) + matrix.tobytes()
    if letter[0] == "n":
        return struct.pack(f">i{len(value)}{letter[1]}", len(value), *value)
    return struct.pack(f">{letter}", value)


def unpack(layout: str, body: bytes) -> tuple[list[Any], int]:
    """Return the values in a body, by a layout, and the index of their end; raise WireError if it is too short."""
    values: list[Any] = []
    at = 0
    try:
        for letter in layout.split():
            value, at = _unpacked(letter, body, at)
            values.append(value)
    except struct.error as error:
        raise WireError(f"a body of {len(body)} bytes is too short: {error}") from error
    return values, at


def _unpacked(letter: str, body: bytes, at: int) -> tuple[Any, int]:
    if letter in ("s", "M") or letter[0] == "n":
        (count,) = struct.unpack_from(">i", body, at)
        at += 4
        if letter == "M":
            (columns,) = struct.unpack_from(">i", body, at)
            end = _within(at + 4, count, columns, 4, body)
            return np.frombuffer(body[at + 4 : end], ">f4").reshape(count, columns).astype(np.float32), end
        if letter == "s":
            end = _within(at, count, 1, 1, body)
            return body[at:end].decode("utf-8", "replace"), end
        end = _within(at, count, 1, struct.calcsize(f">{letter[1]}"), body)
        return list(struct.unpack_from(f">{count}{letter[1]}", body, at)), end
    if letter == "S":
        # The stated number of bytes is ignored, because some clients count only four for each text.
        (count,) = struct.unpack_from(">i", body, at + 4)
        _within(0, count, 1, 0, body)
        texts, at = [], at + 8
        for _ in range(count):
            text, at = _unpacked("s", body, at)
            texts.append(text)
        return texts, at
    return struct.unpack_from(f">{letter}", body, at)[0], at + struct.calcsize(f">{letter}")


def _within(at: int, rows: int, columns: int, size: int, body: bytes) -> int:
    """Return the index at which rows x columns values end; raise WireError for too few bytes or an impossible count."""
    end = at + rows * columns * size
    if rows < 0 or columns < 0 or end > len(body) or (size == 0 and rows > _MOST_NAMES):
        raise WireError(f"{rows} x {columns} values do not fit into a body of {len(body)} bytes")
    return end

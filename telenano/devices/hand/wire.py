"""Handle protocol 1 (PROTOCOL.md of the handle's firmware): frames of a serial haptic device as bytes and back.

On the line a frame is COBS(payload + CRC) + 0x00. The CRC is CRC-16/CCITT-FALSE, low byte first. This module uses no
port and no clock. Quantities are raw counts of the device; `calibration.py` converts them to units.
"""

import binascii
import struct
from collections.abc import Iterator
from enum import IntFlag
from typing import Literal, NamedTuple

MAJOR = 1
MINOR = 0
# With the CRC a frame stays below 254 bytes, where COBS adds exactly one byte.
MAX_PAYLOAD = 60
_CRC_START = 0xFFFF
_CRC_BYTES = 2
# Longest frame without its closing zero: payload, CRC, one byte of COBS.
_MAX_ENCODED = MAX_PAYLOAD + _CRC_BYTES + 1

# The types of frames to the handle.
ASK = 0x01
CONFIG = 0x02
COMMAND = 0x10
STOP = 0x1F
# The types of frames from the handle.
HELLO = 0x81
CONFIGURED = 0x82
STATE = 0x90
FAULT = 0x9F

Fault = Literal["cobs", "crc", "length", "type"]

# Flag of COMMAND: the session runs.
SESSION_RUNS = 1

SEVERITY_FATAL = 2

_HEAD = struct.Struct("<BBH")
_ASK = struct.Struct("<BBHBBHI")
_HELLO = struct.Struct("<BBHBBHQHHfffHBB16s")
_CONFIG = struct.Struct("<BBHHHiiiiii")
_COMMAND = struct.Struct("<BBHHBBii")
_STATE = struct.Struct("<BBHHBBIiiiihHHH")
_STOP = struct.Struct("<BBHH")
_FAULT = struct.Struct("<BBHBB32s")


class HandleAbility(IntFlag):
    """Abilities of a device, in the flags of HELLO."""

    HAS_POSITION_MODE = 1
    HAS_FORCE_MODE = 2
    HAS_FORCE_SENSOR = 4
    FORCE_IS_ESTIMATED = 8
    IS_BACK_DRIVABLE = 32
    SENSES_CURRENT = 64
    IS_EMULATED = 128


class HandleFlag(IntFlag):
    """Condition of a device, in the flags of STATE."""

    IS_CONFIGURED = 1
    WATCHDOG_TRIPPED = 2
    ESTOP_PRESSED = 4
    AT_MIN = 8
    AT_MAX = 16
    VOLTAGE_LIMITED = 32
    CURRENT_LIMITED = 64
    FORCE_SATURATED = 128


class HandleHello(NamedTuple):
    """Identity and abilities of a device; `session` is new at every boot."""

    flags: int
    seq: int
    major: int
    minor: int
    nonce: int
    device_id: int
    session: int
    max_rate_hz: int
    nominal_m_per_count: float
    nominal_n_per_count: float
    nominal_drive_n_per_count: float
    firmware: int
    reset_cause: int
    model: str

    @property
    def identity(self) -> str:
        """Return model, number and firmware of the device for a person."""
        emulated = ", emulated" if self.flags & HandleAbility.IS_EMULATED else ""
        return f"{self.model} {self.device_id:016x}, firmware {self.firmware >> 8}.{self.firmware & 0xFF}{emulated}"

    @property
    def is_understood(self) -> bool:
        """Return whether the device speaks the protocol of this program."""
        return self.major == MAJOR


class Limits(NamedTuple):
    """Limits that the device itself enforces, in counts; the payload of CONFIG and of the answer to it."""

    watchdog_ms: int
    travel_min: int
    travel_max: int
    max_speed_per_s: int
    max_drive: int
    servo_gain_q16: int
    servo_damping_q16: int


class ConfigAnswer(NamedTuple):
    """Answer to CONFIG, with the limits now in force."""

    seq: int
    session: int
    limits: Limits


class HandleState(NamedTuple):
    """One sample of the haptic device, as the frame on its serial line has it: numbers in the units of the device."""

    flags: int
    seq: int
    command_seq: int
    mode: int
    fault: int
    time_us: int
    position: int
    velocity_per_s: int
    force: int
    drive: int
    supply_10mv: int
    overruns: int
    receive_errors: int
    session: int

    @property
    def watchdog_tripped(self) -> bool:
        """Return whether the device got no command for the time of its watchdog, and is off."""
        return bool(self.flags & HandleFlag.WATCHDOG_TRIPPED)


class DeviceFault(NamedTuple):
    """A fault that the device reports; severity 2 means that it cannot continue."""

    seq: int
    code: int
    severity: int
    text: str


Answer = HandleHello | ConfigAnswer | HandleState | DeviceFault
Request = tuple[int, bytes]


class MalformedFrameError(ValueError):
    """Bytes between two zeros are not a frame; `fault` is the kind under which `FrameReader` counts it."""

    def __init__(self, fault: Fault, text: str) -> None:
        super().__init__(text)
        self.fault: Fault = fault


def encode_ask(seq: int, nonce: int) -> bytes:
    """Return the frame that asks a device for its HELLO, which repeats the nonce."""
    return encode_frame(_ASK.pack(ASK, 0, seq & 0xFFFF, MAJOR, MINOR, nonce & 0xFFFF, 0))


def encode_config(seq: int, session: int, limits: Limits) -> bytes:
    """Return the frame that sets the limits of a session."""
    return encode_frame(_CONFIG.pack(CONFIG, 0, seq & 0xFFFF, session, *limits))


def encode_command(seq: int, session: int, flags: int, mode: int, position: int, force: int) -> bytes:
    """Return the frame with the command of a period; position and drive force in counts."""
    return encode_frame(_COMMAND.pack(COMMAND, flags, seq & 0xFFFF, session, mode, 0, position, force))


def encode_stop(seq: int, session: int) -> bytes:
    """Return the frame that switches the drive off until the next CONFIG."""
    return encode_frame(_STOP.pack(STOP, 0, seq & 0xFFFF, session))


def encode_frame(payload: bytes) -> bytes:
    """Return a payload as a frame for the line; raise ValueError if it is empty or longer than MAX_PAYLOAD."""
    if not 0 < len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"a payload has 1 to {MAX_PAYLOAD} bytes, not {len(payload)}")
    whole = payload + binascii.crc_hqx(payload, _CRC_START).to_bytes(_CRC_BYTES, "little")
    # Below 254 bytes COBS means: each run without a zero is preceded by its length + 1.
    return b"".join(bytes((len(run) + 1,)) + run for run in whole.split(b"\0")) + b"\0"


def decode_frame(encoded: bytes) -> bytes:
    """Return the payload of a frame given without its closing zero; raise MalformedFrameError if it is no frame."""
    whole = _unstuffed(encoded)
    if len(whole) <= _CRC_BYTES:
        raise MalformedFrameError("length", f"{len(whole)} bytes are too few for a payload and its CRC")
    payload, crc = whole[:-_CRC_BYTES], int.from_bytes(whole[-_CRC_BYTES:], "little")
    if binascii.crc_hqx(payload, _CRC_START) != crc:
        raise MalformedFrameError("crc", f"the CRC is 0x{crc:04X} and does not fit {len(payload)} bytes of payload")
    return payload


def parse_answer(payload: bytes) -> Answer:
    """Return the answer of a device in a payload; raise MalformedFrameError for an unknown type or wrong length.

    A longer payload of a known type comes from a later minor version; the appended bytes are ignored.
    """
    form = _ANSWERS.get(payload[0])
    if form is None:
        raise MalformedFrameError("type", f"type 0x{payload[0]:02X} is not an answer of a device")
    if len(payload) < form.size:
        raise MalformedFrameError("length", f"type 0x{payload[0]:02X} has {len(payload)} bytes, {form.size} are needed")
    kind, flags, seq, *rest = form.unpack_from(payload)
    if kind == STATE:
        return HandleState(flags, seq, *rest)
    if kind == HELLO:
        *numbers, _, model = rest
        return HandleHello._make((flags, seq, *numbers, _text(model)))
    if kind == CONFIGURED:
        return ConfigAnswer(seq, rest[0], Limits(*rest[1:]))
    return DeviceFault(seq, rest[0], rest[1], _text(rest[2]))


_ANSWERS = {HELLO: _HELLO, CONFIGURED: _CONFIG, STATE: _STATE, FAULT: _FAULT}


class FrameReader:
    """Splits a stream of bytes into payloads; counts malformed frames by kind, and resumes at the next zero."""

    def __init__(self) -> None:
        self.errors: dict[Fault, int] = {"cobs": 0, "crc": 0, "length": 0, "type": 0}
        self._pending = b""
        self._skipping = False

    def payloads(self, received: bytes) -> Iterator[bytes]:
        """Yield the payloads that these bytes complete."""
        *frames, rest = (self._pending + received).split(b"\0")
        for index, encoded in enumerate(frames):
            skipped = index == 0 and self._skipping
            # Several zeros in a row are legal: a sender may put one before a frame to end anything earlier.
            if skipped or not encoded:
                continue
            try:
                yield decode_frame(encoded)
            except MalformedFrameError as error:
                self.errors[error.fault] += 1
        if frames:
            self._skipping = False
        self._pending = rest
        if len(rest) > _MAX_ENCODED:
            self._pending = b""
            self.errors["length"] += not self._skipping
            self._skipping = True

    def answers(self, received: bytes) -> Iterator[Answer]:
        """Yield the answers of a device that these bytes complete."""
        for payload in self.payloads(received):
            try:
                yield parse_answer(payload)
            except MalformedFrameError as error:
                self.errors[error.fault] += 1

    def reset(self) -> None:
        """Discard an incomplete frame, after the port was opened again."""
        self._pending, self._skipping = b"", False


def _unstuffed(encoded: bytes) -> bytes:
    if not 1 < len(encoded) <= _MAX_ENCODED:
        raise MalformedFrameError("length", f"{len(encoded)} bytes between zeros, a frame has 2 to {_MAX_ENCODED}")
    runs, at = [], 0
    while at < len(encoded):
        end = at + encoded[at]
        if end > len(encoded):
            raise MalformedFrameError("cobs", f"a run of {encoded[at] - 1} bytes goes beyond the end of the frame")
        runs.append(encoded[at + 1 : end])
        at = end
    return b"\0".join(runs)


def _text(field: bytes) -> str:
    return "".join(char if char.isprintable() else "?" for char in field.rstrip(b"\0").decode("ascii", "replace"))

"""Requests and answers of Modbus TCP as bytes, built and parsed by pymodbus, without a socket and without waiting.

Function 76 is LabJack's feedback: the device carries out reads and writes in order within one request, and answers with
all registers read. Its frames: type (0 read, 1 write), address, number of registers, and the registers of a write.
"""

import struct
from typing import Any, NamedTuple

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
)

from telenano.wire.errors import TelenanoError

_FRAME = struct.Struct(">BHB")
_HEADER = 8
# This bit in the function code of an answer means that the device refused the request.
_EXCEPTION = 0x80
_LONGEST = 260
# The types of the frames in function 76.
_READ = 0
_WRITE = 1


class Operation(NamedTuple):
    """A read of `length` registers, or a write of `words`, at an address."""

    address: int
    length: int
    words: tuple[int, ...] = ()


class FramingError(TelenanoError, ValueError):
    """The bytes received are no message in Modbus TCP: the connection has to be made again."""


class FeedbackRequest(ModbusPDU):
    """A request of function 76; the device carries out `operations` in this order."""

    function_code = 76
    operations: tuple[Operation, ...] = ()

    def encode(self) -> bytes:
        """Return the body of the request."""
        parts = []
        for address, count, words in self.operations:
            parts.append(_FRAME.pack(_WRITE if words else _READ, address, count))
            parts.append(struct.pack(f">{len(words)}H", *words))
        return b"".join(parts)

    def decode(self, data: bytes) -> None:
        """Read the body of a request.

        Raises:
            FramingError: A frame has an unknown type, or the body ends within a frame.
        """
        frames, at = [], 0
        while at < len(data):
            if len(data) - at < _FRAME.size:
                raise FramingError(f"a frame of function 76 has {len(data) - at} bytes; its head needs {_FRAME.size}")
            kind, address, count = _FRAME.unpack_from(data, at)
            at += _FRAME.size
            words: tuple[int, ...] = ()
            if kind == _WRITE:
                if len(data) - at < 2 * count:
                    raise FramingError(
                        f"a frame of function 76 writes {count} registers at {address}, which are {2 * count} bytes; it"
                        f" has {len(data) - at}"
                    )
                words = struct.unpack_from(f">{count}H", data, at)
                at += 2 * count
            elif kind != _READ:
                raise FramingError(f"frame type {kind} of function 76 is neither 0 (read) nor 1 (write)")
            frames.append(Operation(address, count, words))
        self.operations = tuple(frames)

    def answered(self, registers: list[int]) -> "FeedbackAnswer":
        """Return the answer of the device, with the registers of all reads in a row."""
        return FeedbackAnswer(registers=registers)


class FeedbackAnswer(ModbusPDU):
    """An answer to function 76: the registers of all reads in a row."""

    function_code = 76

    def encode(self) -> bytes:
        """Return the body of the answer."""
        return struct.pack(f">{len(self.registers)}H", *self.registers)

    def decode(self, data: bytes) -> None:
        """Read the body of an answer.

        Raises:
            FramingError: Half a register is missing.
        """
        if len(data) % 2:
            raise FramingError(f"an answer to function 76 has {len(data)} bytes; registers have 2 each")
        self.registers = list(struct.unpack(f">{len(data) // 2}H", data))


class Answer(NamedTuple):
    """The answer of a device: registers in the order of the reads, or the number of an exception (0: none)."""

    words: tuple[int, ...]
    exception: int


class Conversation:
    """Frames one request at a time, and finds its answer in the bytes received."""

    def __init__(self, device_id: int) -> None:
        self._device_id = device_id
        decoder = DecodePDU(False)
        decoder.register(FeedbackAnswer)
        self._framer: Any = FramerSocket(decoder)
        self._transaction = 0
        self._received = b""
        self._function = 0
        # Number of answers that came too late, to requests given up before.
        self.late = 0
        # Number of answers of another unit, or to another function.
        self.refused = 0
        self._refused_last = ""

    @property
    def refusals(self) -> str:
        """Return a report of the refused answers as the end of a sentence; empty if there were none."""
        return f"; {self.refused} answers were refused, the last one {self._refused_last}" if self.refused else ""

    def read(self, address: int, count: int) -> bytes:
        return self._framed(ReadHoldingRegistersRequest(address=address, count=count))

    def write(self, address: int, words: tuple[int, ...]) -> bytes:
        return self._framed(WriteMultipleRegistersRequest(address=address, registers=list(words)))

    def read_write(self, read: Operation, write: Operation) -> bytes:
        return self._framed(
            ReadWriteMultipleRegistersRequest(
                read_address=read.address,
                read_count=read.length,
                write_address=write.address,
                write_registers=list(write.words),
            )
        )

    def feedback(self, operations: tuple[Operation, ...]) -> bytes:
        request = FeedbackRequest()
        request.operations = operations
        return self._framed(request)

    def answer(self, received: bytes) -> Answer | None:
        """Add received bytes, and return the answer to the newest request, or None until it is complete.

        Answers to an older request, of another unit or to another function are skipped and counted: behind a gateway
        several devices share a connection.

        Raises:
            FramingError: The bytes are not Modbus TCP.
        """
        self._received += received
        while len(self._received) >= _HEADER:
            transaction, protocol, length = struct.unpack_from(">HHH", self._received)
            if protocol != 0 or not 2 < length <= _LONGEST - 6:
                raise FramingError(f"protocol id {protocol} with length {length} is not Modbus TCP")
            if len(self._received) < length + 6:
                return None
            frame, self._received = self._received[: length + 6], self._received[length + 6 :]
            if transaction != self._transaction:
                self.late += 1
                continue
            unit, function = frame[6], frame[7]
            if unit != self._device_id or function & ~_EXCEPTION != self._function:
                self.refused += 1
                asked = f"unit {self._device_id} was asked for function {self._function}"
                self._refused_last = f"of unit {unit} to function {function & ~_EXCEPTION}, where {asked}"
                continue
            return self._parsed(frame)
        return None

    def _parsed(self, frame: bytes) -> Answer:
        try:
            _, pdu = self._framer.handleFrame(frame, 0, 0)
        except ModbusException as error:
            raise FramingError(f"an answer of {len(frame)} bytes cannot be read: {error}") from error
        if pdu is None:
            raise FramingError(f"an answer of {len(frame)} bytes cannot be read")
        if isinstance(pdu, ExceptionResponse):
            return Answer((), int(pdu.exception_code))
        return Answer(tuple(pdu.registers), 0)

    def _framed(self, request: ModbusPDU) -> bytes:
        # In pymodbus 0 means no transaction.
        self._transaction = self._transaction % 0xFFFF + 1
        request.transaction_id, request.dev_id = self._transaction, self._device_id
        self._function = request.function_code
        frame: bytes = self._framer.buildFrame(request)
        return frame

"""Register maps of Modbus instruments: registers of output and inputs, checks of identity, and settings."""

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from telenano.settings.config import Settings, read_yaml, validate

MAPS = Path(__file__).parent / "maps"
# The largest number of neighbouring registers that a request can read.
MOST_REGISTERS = 125

RegisterType = Literal["float32", "int16", "uint16", "int32", "uint32"]
_FORMS: dict[str, str] = {"float32": ">f", "int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I"}
# The tolerance is relative, because a float32 comes back rounded.
_SAME = 1e-6


class Register(Settings):
    """A quantity in one or two registers: value = raw * scale + offset."""

    name: str = Field(min_length=1, max_length=64, description="Name in the manual of the device")
    address: int = Field(ge=0, le=65535, description="Address of the first register, from 0")
    per_channel: int = Field(0, ge=0, le=16, description="Increment of the address per channel")
    type: RegisterType = Field(description="float32, int16, uint16, int32 or uint32")
    scale: float = Field(1.0, ge=-1e9, le=1e9, description="Unit of the value for one raw count")
    offset: float = Field(0.0, ge=-1e9, le=1e9, description="Value at raw 0")

    @model_validator(mode="after")
    def _scaled(self) -> "Register":
        if self.scale == 0.0:
            raise ValueError(f"scale of {self.name} must not be 0")
        return self

    @property
    def count(self) -> int:
        return struct.calcsize(_FORMS[self.type]) // 2

    def of_channel(self, channel: int) -> "Register":
        """Return the register of this quantity for a channel."""
        return self.model_copy(update={"address": self.address + self.per_channel * channel, "per_channel": 0})

    def encode(self, value: float, word_order: str) -> tuple[int, ...]:
        """Return the registers that hold a value; raise ValueError if their type cannot hold it."""
        raw = (value - self.offset) / self.scale
        if not math.isfinite(raw):
            raise ValueError(f"{self.name} must be a finite number, not {value}")
        try:
            packed = struct.pack(_FORMS[self.type], raw if self.type == "float32" else round(raw))
        except (struct.error, OverflowError) as error:
            raise ValueError(f"{self.name} = {value:g} does not fit into {self.type}") from error
        words = struct.unpack(f">{self.count}H", packed)
        return words if word_order == "big" else words[::-1]

    def decode(self, words: Sequence[int], word_order: str) -> float:
        """Return the value held by the registers `words`."""
        ordered = words if word_order == "big" else words[::-1]
        (raw,) = struct.unpack(_FORMS[self.type], struct.pack(f">{self.count}H", *ordered))
        return float(raw) * self.scale + self.offset


# Instead of a number, a setting may name one of these values of the calibration file.
SettingName = Literal["range_v", "negative", "resolution_index", "retract_v", "watchdog_s"]


class Setting(Register):
    """A register that is set before the device is driven; it is written only where it differs, and read back."""

    value: float | SettingName = Field(description="A number, or a value of the calibration file")

    def wanted(self, values: Mapping[str, float]) -> float:
        return self.value if isinstance(self.value, float | int) else values[self.value]


class Check(Register):
    """A register with a known value, which shows the kind of the device and the order of its words."""

    value: float = Field(description="Value that the device must answer")
    hint: str = Field("", max_length=200, description="Meaning of another answer")


class Watchdog(Settings):
    """The device's own watchdog: settings that may change only while it is off."""

    enable: Register
    settings: tuple[Setting, ...] = Field(max_length=16)


class Heartbeat(Settings):
    """A script on the device that retracts when the beat stops changing, faster than the device's own watchdog can.

    Host and script communicate through registers: the host writes beat (0: nothing drives), limit_ms, safe_v and the
    address of the output; the script keeps writing its version to `running`, and counts its retractions in `trips`.
    """

    script: str = Field(pattern=r"^[a-z0-9_]+\.lua$", description="File beside the maps")
    version: float = Field(ge=1.0, le=1e6, description="Value that the script writes to `running`")
    beat: Register
    limit_ms: Register
    safe_v: Register
    output: Register
    running: Register
    trips: Register
    run: Register = Field(description="1 runs the script that was loaded, 0 stops it")
    source_size: Register
    source: Register = Field(description="Takes the script in pieces, two bytes a register")
    save: Register
    run_at_power_up: Register

    @property
    def source_bytes(self) -> bytes:
        """Return the script, padded to an even number of bytes."""
        source = (MAPS / self.script).read_bytes()
        return source + b"\n" * (len(source) % 2)


class RegisterMap(Settings):
    """A kind of Modbus instrument."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this file's form")
    model: str = Field(min_length=1, max_length=32, description="Name of the device")
    word_order: Literal["big", "little"] = Field(description="big: the high word of two comes first")
    exchange: Literal["feedback", "read_write", "write_then_read"] = Field(
        description="feedback: function 76 (LabJack); read_write: function 23; write_then_read: functions 16 and 3"
    )
    device_cycle_s: float = Field(1e-3, gt=0.0, le=1.0, description="Time that the device takes for an exchange [s]")
    output: Register = Field(description="Voltage of the output [V]")
    readback: Register = Field(description="Voltage that the output really has [V]")
    input: Register = Field(description="Voltage of the input [V]")
    output_step_v: float = Field(gt=0.0, le=1.0, description="Step of the output's converter [V]")
    serial: Register | None = Field(None, description="Serial number")
    firmware: Register | None = Field(None, description="Version of the firmware")
    checks: tuple[Check, ...] = Field((), max_length=16)
    settings: tuple[Setting, ...] = Field((), max_length=32)
    watchdog: Watchdog | None = None
    heartbeat: Heartbeat | None = None

    @model_validator(mode="after")
    def _span_fits(self) -> "RegisterMap":
        span = self.read_span(0, 0)[1]
        if self.exchange == "read_write" and span > MOST_REGISTERS:
            raise ValueError(
                f"input and readback are {span} registers apart, function 23 reads {MOST_REGISTERS} at most: "
                "write_then_read reads them one by one"
            )
        if self.heartbeat is not None and self.exchange != "feedback":
            raise ValueError("a heartbeat goes with every request: exchange must be feedback")
        return self

    def read_span(self, output: int, channel: int) -> tuple[int, int]:
        """Return address and count of the block that holds input and readback of these channels."""
        parts = (self.input.of_channel(channel), self.readback.of_channel(output))
        first = min(part.address for part in parts)
        return first, max(part.address + part.count for part in parts) - first


def read_map(name: str) -> RegisterMap:
    """Read a register map by its name in the project (such as t7), or from a file.

    Raises:
        ConfigError: The map cannot be read; the message names file and key.
    """
    path = Path(name) if name.endswith((".yaml", ".yml")) else MAPS / f"{name}.yaml"
    return validate(RegisterMap, read_yaml(path), str(path))


def agrees(reading: float, wanted: float) -> bool:
    """Return whether a reading equals the value that was written, within the precision of a float32."""
    return abs(reading - wanted) <= _SAME * max(abs(reading), abs(wanted))


MapName = Annotated[str, Field(pattern=r"^([a-z0-9_]+|.+\.ya?ml)$")]

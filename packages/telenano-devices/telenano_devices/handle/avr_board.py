"""Runs the flashable image of the ATmega328P board in simavr, with the compiled motor and the simulated hand.

The image is the one that `make flash` writes. Time is counted in cycles of its processor. The plant is that of the
emulated handle: duty of the bridge in, sensor out. The board has no force sensor and estimates the force by its drive.
"""

import ctypes
from typing import Any

from telenano.extend.hands import MODE_OFF, MODE_POSITION, DriveCommand
from telenano.sections import HapticConfig
from telenano_devices.handle.emulated_handle import drive_n_per_count, plant_of
from telenano_devices.handle.firmware import SOURCES, FirmwareError, compiled

IMAGE = SOURCES / "boards" / "avr328p" / "handle.hex"
RUNNER = SOURCES.parent / "emulator" / "avr328p.c"
FREQUENCY_HZ = 16_000_000
CYCLES_A_TICK = FREQUENCY_HZ // 1000
DEVICE_ID = 0x0102030405060708
# The number of steps in a turn of the sensor.
SENSOR_STEPS = 1024
SENSOR_MV = 5000
# Travel of the arm for a turn of the sensor [m].
M_PER_TURN = 10e-3
M_PER_COUNT = M_PER_TURN / SENSOR_STEPS
# Count of the sensor at x = 0.
_ZERO_COUNTS = 512
FULL_DUTY = 255
# The drive is a hundredth of the strong motor of the plant, which makes a handle of 25 N.
_FULL_V = 0.1
_SOURCE_V_PER_M = 1.0
_TICK_S = 1e-3
_ROOM = 8192


class AvrBoard:
    """The processor with its image; inputs are bytes, sensor and e-stop switch, outputs are bytes and duty.

    Raises:
        FirmwareError: simavr or a compiler is missing, or the image cannot be read.
    """

    def __init__(self) -> None:
        self._functions = _functions()
        eeprom = DEVICE_ID.to_bytes(8, "little") + b"\0\0"
        self._board = self._functions.board_new(str(IMAGE).encode(), eeprom, len(eeprom))
        if not self._board:
            raise FirmwareError(f"{IMAGE}: cannot be read as an image in Intel hex")
        self._buffer = ctypes.create_string_buffer(_ROOM)
        self.set_estop(pressed=False)
        self.set_position(_ZERO_COUNTS)

    def __del__(self) -> None:
        if getattr(self, "_board", None):
            self._functions.board_free(self._board)
            self._board = None

    @property
    def cycles(self) -> int:
        return int(self._functions.board_cycles(self._board))

    @property
    def duty(self) -> int:
        """Return the duty of the bridge at its pins, -255 to 255."""
        return int(self._functions.board_drive(self._board))

    def run(self, cycles: int) -> None:
        """Run the processor for a number of cycles.

        Raises:
            FirmwareError: The processor has crashed.
        """
        if not self._functions.board_run(self._board, cycles):
            raise FirmwareError(f"the processor has stopped after {self.cycles} cycles")

    def set_position(self, counts: int) -> None:
        """Turn the sensor to a count, modulo SENSOR_STEPS."""
        # The voltage is the middle of a step of the converter, rounded to the millivolts of simavr.
        millivolts = (counts % SENSOR_STEPS + 0.5) * SENSOR_MV / SENSOR_STEPS
        self._functions.board_set_sensor(self._board, round(millivolts))

    def set_estop(self, *, pressed: bool) -> None:
        self._functions.board_set_estop(self._board, int(pressed))

    def hold(self, *, still: bool) -> None:
        """Stop the program, as if it hung, or let it continue."""
        self._functions.board_hold(self._board, int(still))

    def receive(self, received: bytes) -> None:
        self._functions.board_receive(self._board, received, len(received))

    def sent(self) -> bytes:
        """Return the bytes that the board has sent since the last call."""
        length = self._functions.board_sent(self._board, self._buffer, _ROOM)
        return self._buffer.raw[:length]


class AvrHandle:
    """A handle with that board, advanced by milliseconds, with the interface of `EmulatedHandle`."""

    def __init__(self, config: HapticConfig) -> None:
        self._plant = plant_of(config)
        self.board = AvrBoard()

    def reset(self, session: int) -> None:
        """Boot the board again; the arm stays where it is."""
        self.board = AvrBoard()

    def receive(self, received: bytes) -> None:
        self.board.receive(received)

    def sent(self) -> bytes:
        return self.board.sent()

    def advance(self) -> None:
        """Advance plant, sensor and processor by a millisecond."""
        before_m, duty = self._plant.state.plant.motor.position_m, self.board.duty
        command = DriveCommand(MODE_OFF, 0.0, 0.0)
        if duty:
            volts = duty / FULL_DUTY * _FULL_V
            command = DriveCommand(MODE_POSITION, before_m + volts / _SOURCE_V_PER_M, 0.0)
        self._plant.write(command)
        reading = self._plant.read(-1.0, _TICK_S)
        self.board.set_position(_ZERO_COUNTS + round(reading.position_m / M_PER_COUNT))
        self.board.run(CYCLES_A_TICK)


def calibration_of(config: HapticConfig) -> dict[str, object]:
    """Return the content of a calibration file that fits the emulated board; its force is that of the drive."""
    from datetime import UTC, datetime

    # The force of a duty count follows from that of a millivolt.
    force_n = drive_n_per_count(config.device.to_params()) * 1e3 * _FULL_V / FULL_DUTY
    return {
        "schema": 1,
        "device_id": f"{DEVICE_ID:016x}",
        "calibrated": datetime(2026, 1, 1, tzinfo=UTC),
        "position": {"zero_raw": _ZERO_COUNTS, "m_per_count": M_PER_COUNT},
        "force": {"zero_raw": 0, "n_per_count": force_n, "saturation_n": force_n * FULL_DUTY},
        "drive": {"n_per_count": force_n},
        "servo": {"stiffness_n_per_m": 0.5 * force_n / M_PER_COUNT},
        "watchdog_s": 0.02,
        "max_force_n": force_n * FULL_DUTY,
    }


def _functions() -> Any:
    arguments = ["-std=gnu99", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", str(RUNNER), "-lsimavr"]
    purpose = "the image of a board runs in simavr, whose runner needs"
    library = compiled("avr328p", [RUNNER], arguments, purpose, extra=" libsimavr-dev libelf-dev")
    try:
        loaded = ctypes.CDLL(str(library))
    except OSError as error:
        raise FirmwareError(f"{purpose} libsimavr: {error}") from error
    u32, u64, i32 = ctypes.c_uint32, ctypes.c_uint64, ctypes.c_int32
    pointer, text = ctypes.c_void_p, ctypes.c_char_p
    table: dict[str, tuple[Any, tuple[Any, ...]]] = {
        "board_new": (pointer, (text, text, u32)),
        "board_free": (None, (pointer,)),
        "board_run": (ctypes.c_int, (pointer, u64)),
        "board_receive": (None, (pointer, text, u32)),
        "board_sent": (u32, (pointer, text, u32)),
        "board_set_sensor": (None, (pointer, u32)),
        "board_set_estop": (None, (pointer, u32)),
        "board_hold": (None, (pointer, u32)),
        "board_drive": (i32, (pointer,)),
        "board_cycles": (u64, (pointer,)),
    }
    for name, (result, given) in table.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, given
    return loaded

"""The image that is flashed, in simavr: handle protocol 1 and its watchdog, counted in cycles of the processor."""

import itertools
import os
from collections.abc import Callable

import pytest
from telenano_devices.handle.avr_board import CYCLES_A_TICK, DEVICE_ID, FREQUENCY_HZ, AvrBoard
from telenano_devices.handle.firmware import FirmwareError

from telenano.extend.hands import MODE_FORCE, MODE_OFF, MODE_POSITION
from telenano.testing import handle_wire as wire

WATCHDOG_MS = 20
LIMITS = wire.Limits(
    watchdog_ms=WATCHDOG_MS,
    travel_min=-5000,
    travel_max=5000,
    max_speed_per_s=100_000,
    max_drive=200,
    servo_gain_q16=65536,
    servo_damping_q16=0,
)
# bit WDRF of MCUSR
WATCHDOG_RESET = 8
HALF_MS = CYCLES_A_TICK // 2

try:
    AvrBoard()
except FirmwareError as error:
    pytest.skip(f"needs simavr: apt install gcc libsimavr-dev libelf-dev ({str(error)[:80]})", allow_module_level=True)


class Host:
    """Talks to a board; every millisecond of it is CYCLES_A_TICK cycles."""

    def __init__(self) -> None:
        self.board = AvrBoard()
        self.reader = wire.FrameReader()
        self.seq, self.session = 0, 0

    def pass_ms(self, duration_ms: int) -> list[wire.Answer]:
        found: list[wire.Answer] = []
        for _ in range(duration_ms):
            self.board.run(CYCLES_A_TICK)
            found += self.reader.answers(self.board.sent())
        return found

    def send(self, encode: Callable[..., bytes], *arguments: object) -> None:
        self.board.receive(encode(self.seq, *arguments))
        self.seq += 1

    def greet(self) -> wire.HandleHello:
        self.pass_ms(5)
        self.send(wire.encode_ask, 0x1234)
        (hello,) = [answer for answer in self.pass_ms(5) if isinstance(answer, wire.HandleHello)]
        self.session = hello.session
        return hello

    def configure(self) -> wire.Limits:
        self.send(wire.encode_config, self.session, LIMITS)
        (configured,) = [answer for answer in self.pass_ms(5) if isinstance(answer, wire.ConfigAnswer)]
        return configured.limits

    def command(self, mode: int, position: int = 0, force: int = 0) -> wire.HandleState:
        """Send a command and return the state that answers it, a millisecond or two later."""
        wanted = self.seq & 0xFFFF
        self.send(wire.encode_command, self.session, 0, mode, position, force)
        answers = [answer for answer in self.pass_ms(2) if isinstance(answer, wire.HandleState)]
        (state,) = [answer for answer in answers if answer.command_seq == wanted]
        return state


@pytest.fixture
def host() -> Host:
    found = Host()
    found.greet()
    assert found.configure() == LIMITS
    found.command(MODE_OFF)
    return found


def test_image_says_who_it_is_and_begins_a_session() -> None:
    first = Host()
    hello = first.greet()
    assert (hello.major, hello.device_id, hello.model, hello.nonce) == (1, DEVICE_ID, "telenano avr328p", 0x1234)
    assert hello.session != 0
    assert hello.flags & wire.HandleAbility.FORCE_IS_ESTIMATED
    assert not hello.flags & wire.HandleAbility.HAS_FORCE_SENSOR
    assert sum(first.reader.errors.values()) == 0


def test_commands_reach_the_pins_within_two_milliseconds_and_limits_hold(host: Host) -> None:
    for force, duty in ((50, 50), (-120, -120), (1000, 200)):
        state = host.command(MODE_FORCE, force=force)
        host.pass_ms(1)
        assert (state.mode, host.board.duty) == (MODE_FORCE, duty)
    assert host.command(MODE_FORCE, force=30).drive in (30, 200)
    host.command(MODE_OFF)
    assert host.board.duty == 0


def test_sensor_is_followed_round_its_seam_and_the_servo_pulls_towards_the_reference(host: Host) -> None:
    for counts in (600, 900, 1100, 1400):
        host.board.set_position(counts)
        host.pass_ms(1)
        assert abs(host.command(MODE_OFF).position - counts) <= 1
    for number in range(20):
        state = host.command(MODE_POSITION, position=1400 + 5 * number)
    # a gain of 1: the duty is the way that is left
    host.pass_ms(1)
    assert host.board.duty == pytest.approx(1400 + 5 * 19 - state.position, abs=2)


def test_silence_switches_the_motor_off_within_the_watchdog_counted_in_cycles(host: Host) -> None:
    host.command(MODE_FORCE, force=100)
    host.pass_ms(3)
    host.send(wire.encode_command, host.session, 0, MODE_FORCE, 0, 100)
    # the last byte of the command is in after 20 bytes of 10 us
    host.board.run(HALF_MS)
    heard = host.board.cycles
    assert host.board.duty == 100
    while host.board.duty:
        host.board.run(100)
        assert host.board.cycles - heard < FREQUENCY_HZ
    silent_ms = (host.board.cycles - heard) * 1e3 / FREQUENCY_HZ
    assert WATCHDOG_MS - 1.5 <= silent_ms <= 1.05 * WATCHDOG_MS
    # an old reference does not drive again: only the command off does away with it
    assert host.command(MODE_FORCE, force=100).flags & wire.HandleFlag.WATCHDOG_TRIPPED
    host.pass_ms(2)
    assert host.board.duty == 0
    host.command(MODE_OFF)
    host.command(MODE_FORCE, force=100)
    host.pass_ms(1)
    assert host.board.duty == 100


def test_program_that_hangs_is_reset_by_the_hardware_with_the_motor_off(host: Host) -> None:
    host.command(MODE_FORCE, force=100)
    host.pass_ms(1)
    assert host.board.duty == 100
    session, began = host.session, host.board.cycles
    host.board.hold(still=True)
    while host.board.duty:
        host.board.run(1000)
        assert host.board.cycles - began < FREQUENCY_HZ
    # 30 ms of an oscillator of its own
    assert (host.board.cycles - began) * 1e3 / FREQUENCY_HZ <= 35.0
    host.board.hold(still=False)
    hello = host.greet()
    assert hello.session not in (0, session)
    assert hello.reset_cause & WATCHDOG_RESET
    assert host.board.duty == 0


def test_open_switch_of_the_emergency_stop_cuts_the_drive_and_latches(host: Host) -> None:
    host.command(MODE_FORCE, force=100)
    host.board.set_estop(pressed=True)
    host.pass_ms(2)
    assert host.board.duty == 0
    host.board.set_estop(pressed=False)
    assert host.command(MODE_FORCE, force=100).flags & wire.HandleFlag.ESTOP_PRESSED
    host.pass_ms(1)
    assert host.board.duty == 0
    host.configure()
    host.command(MODE_OFF)
    host.command(MODE_FORCE, force=100)
    host.pass_ms(1)
    assert host.board.duty == 100


def test_garbage_on_the_line_is_counted_and_drives_nothing(host: Host) -> None:
    host.board.receive(b"AT+CGMI\r\x00\x05\x01\x02\x00" + os.urandom(30).replace(b"\0", b"\1") + b"\0")
    host.pass_ms(3)
    assert host.board.duty == 0
    assert host.command(MODE_OFF).receive_errors >= 2


def test_thousand_commands_a_second_are_each_answered(host: Host) -> None:
    states = []
    for _ in range(200):
        host.send(wire.encode_command, host.session, 0, MODE_OFF, 0, 0)
        states += [answer for answer in host.pass_ms(1) if isinstance(answer, wire.HandleState)]
    assert len(states) >= 198
    assert states[-1].overruns == states[0].overruns
    assert {(after.seq - before.seq) & 0xFFFF for before, after in itertools.pairwise(states)} == {1}
    assert sum(host.reader.errors.values()) == 0

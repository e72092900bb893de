"""The serial driver against the firmware, in virtual time: handshake, samples and ages."""

import shutil
from typing import Any

import pytest

if shutil.which("cc") is None:
    pytest.skip("the emulated handle needs a C compiler: apt install gcc libc6-dev", allow_module_level=True)

from telenano_devices.handle.handle_line import PATH, HandleLine, HandleRig, calibration
from telenano_devices.handle.simulate_handle import handled

from telenano.devices.hand.serial_driver import refusal
from telenano.extend.hands import MODE_FORCE, MODE_OFF, MODE_POSITION, DeviceError, DriveCommand
from telenano.hand.sim import SimulatedHaptic
from telenano.sections.hand_section import HapticConfig
from telenano.wire.errors import ConfigError, RefusedError

OFF = DriveCommand(MODE_OFF, 0.0, 0.0)


def towards(position_m: float) -> DriveCommand:
    return DriveCommand(MODE_POSITION, position_m, 0.0)


@pytest.fixture
def line() -> HandleLine:
    found = HandleLine()
    found.driver.open()
    return found


def tick(line: HandleLine, command: DriveCommand = OFF, count: int = 1, session_s: float = -1.0) -> Any:
    """Let the driver do what a node does in so many milliseconds; return the last reading."""
    for _ in range(count):
        line.driver.write(command)
        line.pass_ms(1)
        reading = line.driver.read(session_s, 1e-3)
    return reading


def test_opens_configures_and_follows(line: HandleLine) -> None:
    assert line.driver.report.status == "ok"
    assert "telenano posix 0102030405060708, firmware 1.0, emulated is ready" in line.driver.report.text
    assert line.driver.capabilities.modes == (MODE_OFF, MODE_POSITION)
    reading = tick(line, towards(5e-3), 500)
    assert line.handle.position_m == pytest.approx(5e-3, abs=5e-6, rel=0.0)
    # the sample is that of the tick before; the arm stands, to a count
    assert reading.position_m == pytest.approx(line.handle.position_m, abs=1e-8, rel=0.0)
    assert line.driver.missed == 0
    assert sum(line.driver.reader.errors.values()) == line.handle.core.receive_errors == 0


def test_device_limits_travel_speed_and_drive_by_itself(line: HandleLine) -> None:
    before_m = line.handle.position_m
    tick(line, towards(1.0), 100)
    speed = (line.handle.position_m - before_m) / 0.1
    assert speed <= 0.036
    tick(line, towards(1.0), 600)
    assert line.handle.position_m == pytest.approx(0.0145, abs=5e-6, rel=0.0)


def test_hand_moves_with_the_session_and_its_force_is_measured(line: HandleLine) -> None:
    tick(line, towards(0.0), 3)
    reading = tick(line, towards(0.0), 1300, session_s=0.1)
    assert reading.operator_force_n == pytest.approx(1.0, abs=1e-4, rel=0.0)


def test_declared_latency_is_what_the_arm_is_behind_a_simulated_one(line: HandleLine) -> None:
    line.latency_ms = 0.6
    config = HapticConfig()
    simulated = SimulatedHaptic(config.to_plant_params(), config.device.start_position_m)
    simulated.open()
    tick(line, towards(0.0), 20)
    speed_m_per_s, lags_s = 0.02, []
    for number in range(500):
        command = towards(speed_m_per_s * number * 1e-3)
        simulated.write(command)
        same = simulated.read(-1.0, 1e-3)
        # in the order of the node: the answer to this command is not there yet
        line.pass_ms(1)
        line.driver.write(command)
        lags_s.append((same.position_m - line.driver.read(-1.0, 1e-3).position_m) / speed_m_per_s)
    # once both servos follow
    assert sum(lags_s[300:]) / 200 == pytest.approx(2.5e-3, abs=0.05e-3, rel=0.0)
    assert line.driver.capabilities.latency_s == pytest.approx(2.5e-3)
    own = HandleLine(calibration(latency_s=5e-3))
    own.driver.open()
    assert own.driver.capabilities.latency_s == 5e-3


def test_age_is_that_of_the_sample(line: HandleLine) -> None:
    tick(line, count=100)
    # the answer is seen a millisecond after the command; a half of that is the way back
    young_s = line.driver.report.age_s
    assert 0.5e-3 <= young_s <= 1.6e-3
    line.to_host = lambda sent: b""
    tick(line, count=4)
    assert line.driver.report.age_s == pytest.approx(young_s + 4e-3, abs=1e-9, rel=0.0)


def test_modes_that_the_device_has_not_are_refused(line: HandleLine) -> None:
    with pytest.raises(DeviceError, match="cannot be driven in mode force"):
        line.driver.write(DriveCommand(MODE_FORCE, 0.0, 1.0))


def test_silence_switches_the_motor_off_within_the_watchdog(line: HandleLine) -> None:
    tick(line, towards(5e-3), 50)
    assert line.handle.core.mode == MODE_POSITION
    since_ms = 0
    while line.handle.core.mode != MODE_OFF:
        line.pass_ms(1)
        since_ms += 1
    # the last command came at the beginning of a millisecond that has passed
    assert since_ms == 19
    assert line.handle.drive_v == 0.0


def test_watchdog_is_left_only_by_a_command_off(line: HandleLine) -> None:
    tick(line, towards(5e-3), 50)
    line.pass_ms(25)
    line.driver.read(-1.0, 1e-3)
    assert line.driver.report.status == "lost"
    tick(line, towards(5e-3), 20)
    assert (line.handle.core.mode, line.driver.report.status) == (MODE_OFF, "lost")
    tick(line, OFF, 2)
    assert line.driver.report.status == "ok"
    tick(line, towards(5e-3), 2)
    assert line.handle.core.mode == MODE_POSITION


def test_dropped_frames_are_counted_by_their_numbers(line: HandleLine) -> None:
    tick(line, count=10)
    line.to_host = lambda sent: b""
    tick(line, count=3)
    line.to_host = lambda sent: sent
    tick(line, count=3)
    assert line.driver.missed == 3
    assert line.driver.report.status == "ok"


def test_two_commands_in_one_period_of_the_device_lose_no_frame(line: HandleLine) -> None:
    """The clocks of host and device drift, so that this comes about once a second."""
    for _ in range(5):
        tick(line, count=10)
        line.driver.write(OFF)
        tick(line, count=2)
    assert (line.driver.missed, line.driver.repeated) == (0, 5)


def test_silent_device_is_stale_and_then_lost(line: HandleLine) -> None:
    tick(line, count=5)
    line.to_host = lambda sent: b""
    seen = []
    for _ in range(60):
        tick(line)
        seen.append(line.driver.report.status)
    assert seen[:4] == ["ok"] * 4
    assert set(seen[6:48]) == {"stale"}
    assert seen[-1] == "lost"
    assert "silent for 50 ms" in line.driver.report.text


def test_reset_is_reported_of_a_board_that_was_silent_while_it_booted(line: HandleLine) -> None:
    tick(line, towards(2e-3), 50)
    line.to_host = lambda sent: b""
    tick(line, towards(2e-3), 60)
    assert "silent for 50 ms" in line.driver.report.text
    line.handle.reset(0x1234)
    line.to_host = lambda sent: sent
    tick(line, OFF, 700)
    assert line.driver.report.status == "ok"
    assert f"is ready; the handle was reset: session {0x1234}, not {0xBEEF}" in line.driver.report.text


@pytest.mark.parametrize(("rate_hz", "refused"), [(100, False), (1000, False), (2000, True)])
def test_a_handle_is_refused_by_a_loop_that_is_faster_than_it(line: HandleLine, rate_hz: int, refused: bool) -> None:
    line.driver.open()
    assert line.driver.hello is not None
    slow = line.driver.hello._replace(max_rate_hz=1000)
    text = refusal(slow, calibration(), 1.0 / rate_hz)
    assert text == ("the handle takes 1000 commands a second, 2000 are needed" if refused else "")


def test_nobody_there_is_a_sentence_after_three_seconds() -> None:
    line = HandleLine()
    line.to_host = lambda sent: b""
    began_ns = line.now_ns
    with pytest.raises(DeviceError, match=r"nothing answers in handle protocol 1 at 1000000 baud"):
        line.driver.open()
    assert 3.0 <= (line.now_ns - began_ns) * 1e-9 < 3.2
    line.plugged = False
    with pytest.raises(DeviceError, match=PATH):
        line.driver.open()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"position": {"zero_raw": 0, "m_per_count": 0.0}}, r"position: m_per_count must not be 0"),
        ({"drive": {"n_per_count": -1.0}}, r"drive.n_per_count"),
        ({"device_id": "1234"}, r"device_id"),
        ({"unit": "mm"}, r"unit"),
        ({"watchdog_s": 1.0}, r"watchdog_s"),
        ({"max_force_n": 1e-9}, r"max_force_n"),
    ],
)
def test_bad_calibration_names_the_key(change: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        calibration(**change)


def test_sign_of_the_calibration_turns_everything_round() -> None:
    zero = calibration().position.zero_raw
    turned = calibration(position={"zero_raw": zero, "m_per_count": -1e-8})
    limits = turned.device_limits(HapticConfig().limits)
    assert limits.travel_min < limits.travel_max
    assert turned.position_raw(1e-3) == zero - 100_000
    assert turned.drive_raw(2.5 * turned.drive.n_per_count) == -2
    assert turned.drive_force_n(4) < 0.0


def test_gauges_and_masses_at_the_emulated_handle_until_it_is_driven(line: HandleLine) -> None:
    assert handled(line.handle, "gauge 0.005\n") == "the arm stands at 0.005 m until it is driven"
    assert handled(line.handle, "mass 0.2\n") == "0.2 kg pull at the arm until it is driven"
    reading = tick(line, count=5)
    assert reading.position_m == pytest.approx(5e-3, abs=1e-8, rel=0.0)
    assert reading.operator_force_n == pytest.approx(0.2 * 9.80665, abs=1e-4, rel=0.0)
    reading = tick(line, towards(5e-3), 50)
    assert reading.position_m == pytest.approx(5e-3, abs=5e-6, rel=0.0)
    assert reading.operator_force_n == pytest.approx(0.0, abs=1e-4)
    for wrong in ("gauge\n", "gauge 1 mm\n", "mass nan\n", "hello\n"):
        assert "is not known: Enter, `gauge M` or `mass KG`" in handled(line.handle, wrong)


def test_node_publishes_state_and_age_and_recovers_without_a_jump(bench_of: Any) -> None:
    rig = HandleRig(bench_of("haptic_node@master"))
    rig.line.latency_ms = 0.6
    rig.tick(20)
    states = rig.bench.take("haptic/state")
    assert {(state.v, state.device, state.mode) for state in states[1:]} == {(1, "ok", "position")}
    assert all(0.0 <= state.sample_age_s < 3e-3 for state in states[1:])
    delay = rig.node.device_health()
    assert delay["device_latency_s"] == 2.5e-3
    assert 0.5e-3 < delay["device_age_s"] < 2.5e-3
    # a new interval began
    assert "device_age_s" not in rig.node.device_health()
    rig.line.plugged = False
    rig.x_m = 8e-3
    rig.tick(40)
    lost = rig.bench.take("haptic/state")[-1]
    assert (lost.device, lost.mode) == ("lost", "off")
    rig.line.plugged = True
    stood_m = rig.line.handle.position_m
    rig.tick(700)
    states = rig.bench.take("haptic/state")
    back = next(index for index, state in enumerate(states) if state.mode == "position")
    assert -states[back].reference_m[2] == pytest.approx(stood_m, abs=1e-4, rel=0.0)
    steps = [abs(a.position_m[2] - b.position_m[2]) for a, b in zip(states[back:], states[back + 1 :], strict=False)]
    assert max(steps) <= 0.036e-3 * 1.05
    assert rig.line.handle.position_m > 3e-3
    texts = [event.text for event in rig.bench.take("session/event")]
    assert any("calibration 0102030405060708" in text for text in texts)
    assert any("the device is gone" in text for text in texts)
    assert any("the device is lost: off until it is back" in text for text in texts)


def test_emergency_stop_of_the_device_latches_at_the_node(bench_of: Any) -> None:
    rig = HandleRig(bench_of("haptic_node@master"))
    rig.tick(10)
    rig.line.handle.estop_pressed = True
    rig.tick(3)
    assert rig.line.handle.core.mode == MODE_OFF
    rig.line.handle.estop_pressed = False
    rig.tick(20)
    state = rig.bench.take("haptic/state")[-1]
    assert (state.mode, state.estop) == ("off", True)


def test_a_handle_that_holds_its_own_stop_is_not_armed_until_it_is_connected_anew(bench_of: Any) -> None:
    rig = HandleRig(bench_of("haptic_node@master"))
    rig.tick(10)
    fields = {"id": "a", "command": "arm", "target": "*", "parameters": {}}
    arm = rig.bench.make("session/control", "console@master", **fields)
    rig.line.handle.estop_pressed = True
    rig.tick(20)
    rig.line.handle.estop_pressed = False
    rig.tick(20)
    assert (rig.node.own_stops, rig.node.is_latched) == (1, True)
    with pytest.raises(RefusedError, match="the device itself reports an emergency stop"):
        rig.node.on_control(arm)
    rig.line.plugged = False
    rig.tick(40)
    rig.line.plugged = True
    rig.tick(700)
    assert rig.node.is_latched
    rig.node.on_control(arm)
    rig.tick(3)
    assert (rig.node.own_stops, rig.node.is_latched) == (1, False)

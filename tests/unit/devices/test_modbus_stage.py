"""The Modbus driver against the T7 model, in virtual time: identity, samples and maps."""

import math
import socket
import struct
from typing import Any

import pytest
from pymodbus.pdu import ModbusPDU
from telenano_devices.t7 import t7_model
from telenano_devices.t7.stage_line import PARAMS, StageLine, StageRig, calibration

from telenano.afm.sim import simulated_afm
from telenano.devices.afm.modbus_driver import ModbusAfm
from telenano.devices.afm.modbus_frames import Conversation, FeedbackAnswer, FeedbackRequest, FramingError, Operation
from telenano.devices.afm.register_map import Register, RegisterMap, read_map
from telenano.extend.instruments import DeviceError
from telenano.sections.afm_section import AfmConfig
from telenano.testing import VirtualClock
from telenano.wire.errors import ConfigError

MS = 1_000_000

RETRACTED_M = PARAMS.safety.retract_position_m
DAC_STEP_M = 5.0 / 4095.0 * t7_model.M_PER_V


@pytest.fixture
def line() -> StageLine:
    found = StageLine()
    found.driver.open()
    return found


def tick(line: StageLine, base_m: float = RETRACTED_M, count: int = 1) -> Any:
    """Let the driver do what a node does in so many milliseconds; return the last sample."""
    return line.follow(base_m, count)


def test_identifies_sets_up_retracts_and_follows(line: StageLine) -> None:
    assert line.driver.report.status == "ok"
    assert "LabJack T7 470012345, firmware 1.0292 is ready and retracted" in line.driver.report.text
    assert line.model.output_v == 0.0
    values = {address: line.model.value(address) for address in (40000, 41500, 61600, 61604, 61640, 61642)}
    assert values == {40000: pytest.approx(0.1), 41500: 1.0, 61600: 1.0, 61604: 1.0, 61640: 1.0, 61642: 0.0}
    tick(line)
    sample = tick(line, 0.0, 300)
    assert sample.base_m == pytest.approx(0.0, abs=DAC_STEP_M, rel=0.0)
    assert not sample.distance_valid


def test_force_is_that_of_the_simulated_instrument_within_a_step_of_the_converters(line: StageLine) -> None:
    simulated = simulated_afm(PARAMS)
    simulated.open()
    tick(line)
    for base_m in (0.0, 8e-9, 14e-9, 20e-9):
        sample = tick(line, base_m, 200)
        # along the same way, as the tip has a history
        for step in range(200):
            same = simulated.exchange(sample.base_m * step / 199 if base_m == 0.0 else sample.base_m)
        adc_n = 40.0 * 2 * t7_model.RANGE_V / 65536 / PARAMS.plant.volts_per_m
        assert sample.force_n == pytest.approx(same.force_n, abs=1.01 * adc_n, rel=0.0)
        assert sample.in_contact == (sample.force_n > 1e-9)


def test_spring_behind_the_converters_is_seen_by_a_bridge() -> None:
    spring = {"stiffness_n_per_m": 38.0, "rest_position_m": 1e-9, "bilateral": False}
    config = AfmConfig.model_validate({"environment": "spring", "spring": spring})
    model = t7_model.T7Model(t7_model.instrument_of(config), output_step_v=1e-6)
    for base_m in (0.0, 2e-9):
        model.write(1000, struct.unpack(">2H", struct.pack(">f", 2.5 + base_m / t7_model.M_PER_V)), 0)
        (volts,) = struct.unpack(">f", struct.pack(">2H", *model.read(0, 2, 0)))
        # F = K (x_s - L), zeta = F / k
        force_n = 38.0 * max(0.0, base_m - 1e-9)
        expected_v = force_n / PARAMS.plant.stiffness_n_per_m * PARAMS.plant.volts_per_m
        assert volts == pytest.approx(expected_v, abs=20.0 / 65536)
    with pytest.raises(ConfigError, match="has tip_sample or spring behind it"):
        t7_model.instrument_of(AfmConfig().model_copy(update={"environment": "layered"}))


def test_settings_that_are_in_flash_are_written_only_where_they_differ(line: StageLine) -> None:
    written = line.model.flash_writes
    assert written > 0
    line.driver.close()
    line.driver.open()
    assert line.model.flash_writes == written


@pytest.mark.parametrize(("cycle_s", "latency_s"), [(0.4e-3, 1e-3), (1.2e-3, 2.5e-3), (2.6e-3, 4e-3)])
def test_declared_latency_is_what_the_base_lags_by(cycle_s: float, latency_s: float) -> None:
    line = StageLine(registers=read_map("t7").model_copy(update={"device_cycle_s": cycle_s}))
    line.driver.open()
    line.latency_ms = 1e3 * cycle_s
    tick(line, -150e-9, 200)
    speed_m_per_s, lags_s = 100e-9, []
    for number in range(600):
        base_m = -150e-9 + speed_m_per_s * number * 1e-3
        lags_s.append((base_m - tick(line, base_m).base_m) / speed_m_per_s)
    # a step of the output is a millisecond of this ramp: their mean tells a hundredth of it
    assert sum(lags_s[100:]) / 500 == pytest.approx(latency_s, abs=0.1e-3, rel=0.0)
    assert line.driver.latency_s == pytest.approx(latency_s, abs=0.0)
    own = StageLine(calibration(latency_s=7e-3)).driver
    assert own.latency_s == 7e-3


def test_a_tick_never_waits_and_has_one_request_out(line: StageLine) -> None:
    line.latency_ms = 3
    began_ns, sent, exchanges = line.now_ns, line.sent, line.driver.exchanges
    tick(line, count=300)
    assert line.now_ns - began_ns == 300 * MS
    assert line.sent - sent == pytest.approx(100, abs=2)
    assert line.driver.exchanges - exchanges == pytest.approx(100, abs=2)
    assert line.driver.report.status == "ok"
    assert 3e-3 <= line.driver.report.age_s <= 7e-3


def test_voltage_moves_no_faster_than_its_slew_limit(line: StageLine) -> None:
    tick(line)
    before_v = line.model.output_v
    tick(line, 0.0, 20)
    assert (line.model.output_v - before_v) <= 25.0 * 20e-3 + 2e-3
    assert line.model.output_v > before_v + 0.2


def test_base_that_is_not_finite_is_refused(line: StageLine) -> None:
    with pytest.raises(ValueError, match="must be finite"):
        line.driver.exchange(math.nan)


def test_input_beyond_its_range_is_no_force_to_the_guard(line: StageLine) -> None:
    tick(line)
    line.model._move = lambda volts: None  # type: ignore[method-assign]
    line.model._bridge_v = 0.2
    tick(line, count=2)
    assert not line.driver.report.force_valid
    assert math.isfinite(line.driver.exchange(RETRACTED_M).force_n)


def test_stopped_server_is_stale_then_lost_and_comes_back_retracted(line: StageLine) -> None:
    tick(line)
    tick(line, 10e-9, 200)
    line.running = False
    seen = []
    for _ in range(60):
        tick(line, 10e-9)
        seen.append(line.driver.report.status)
    assert seen[3] == "ok"
    assert "stale" in seen[8:45]
    assert seen[-1] == "lost"
    # without our script on the device its own watchdog needs whole seconds
    line.pass_ms(1100)
    assert (line.model.trips, line.model.output_v) == (1, 0.0)
    line.running = True
    tick(line, 10e-9, 1500)
    # the guard had the base near the sample all the time: nothing moves before it has it retracted
    assert line.driver.report.status == "ok"
    assert line.model.output_v == 0.0
    tick(line)
    tick(line, 10e-9, 200)
    assert line.model.output_v == pytest.approx(2.5 + 10e-9 / 8e-8, abs=2e-3)


def test_host_that_swallows_everything_costs_no_tick_and_is_a_sentence() -> None:
    # nobody accepts, and the queue is full: a connection is never made and never refused
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        port = server.getsockname()[1]
        others = [socket.socket() for _ in range(4)]
        for other in others:
            other.setblocking(False)
            other.connect_ex(("127.0.0.1", port))
        clock = VirtualClock(start_ns=10**9)
        driver = ModbusAfm(
            calibration(network={"host": "127.0.0.1", "port": port}),
            read_map("t7"),
            PARAMS.safety,
            now_ns=clock.monotonic_ns,
            sleep=lambda duration_s: clock.advance_ns(max(MS, round(duration_s * 1e9))),
        )
        with pytest.raises(DeviceError, match="does not answer: check address, cable and firewall"):
            driver.open()
        # as in a session whose network has gone
        driver._opened = True
        began_ns = clock.monotonic_ns()
        for _ in range(3000):
            clock.advance_ns(MS)
            driver.exchange(0.0)
            assert driver.report.status == "lost"
        # the clock went on by the ticks alone: nothing waited
        assert clock.monotonic_ns() - began_ns == 3000 * MS
        driver.close()
        for other in others:
            other.close()


@pytest.mark.parametrize("garbage", [b"HTTP/1.1 400 Bad Request\r\n", b"\0\1\0\0\xff\xff\1\3", b"\0\1\0\0\0\2\1\3"])
def test_garbage_closes_the_connection(line: StageLine, garbage: bytes) -> None:
    tick(line)
    closed = line.closed
    line.to_host = lambda sent: garbage
    tick(line, count=2)
    assert line.driver.report.status == "lost"
    assert line.closed == closed + 1


def refused(change: Any = None, **calibrated: Any) -> str:
    """Open a device that is not what it should be; return the sentence, nothing having been driven."""
    line = StageLine(calibration(**calibrated) if calibrated else None)
    line.model._move(3.0)
    if change is not None:
        change(line)
    with pytest.raises(ConfigError) as caught:
        line.driver.open()
    assert line.model.output_v == pytest.approx(3.0, abs=2e-3)
    return str(caught.value)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"stage": {"m_per_v": 0.0}}, r"stage.m_per_v"),
        ({"stage": {"m_per_v": -8e-8}}, r"stage.m_per_v"),
        ({"deflection": {"v_per_m": 0.0}}, r"v_per_m = 0.0 V/m"),
        ({"stage": {"max_v": 4.0}}, r"safety.base_max_m = 2e-07 m needs 5.000 V"),
        ({"stage": {"retract_v": 2.4, "unsafe_wiring_acknowledged": True}}, r"nearer to the sample than"),
        ({"stage": {"retract_v": 0.1}}, r"unsafe_wiring_acknowledged: true"),
        ({"instrument": {"serial": None}}, r"instrument.serial is missing"),
        ({"instrument": {"map": "no such"}}, r"instrument.map"),
    ],
)
def test_bad_calibration_says_what_would_be_right(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        StageLine(calibration(**changes))


def test_unknown_register_type_and_missing_map_are_named(tmp_path: Any) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "schema: 1\nmodel: x\nword_order: big\nexchange: feedback\noutput: {name: a, address: 0, type: f16}\n"
    )
    with pytest.raises(ConfigError, match=r"output.type"):
        read_map(str(path))
    with pytest.raises(ConfigError, match=r"t99"):
        read_map("t99")


@pytest.mark.parametrize(("exchange", "a_cycle"), [("write_then_read", 3), ("read_write", 1)])
def test_generic_maps_drive_the_same_instrument(exchange: str, a_cycle: int) -> None:
    whole = read_map("t7").model_dump(by_alias=True)
    spread = {"readback": {"name": "DAC", "address": 2, "type": "float32"}} if exchange == "read_write" else {}
    line = StageLine(registers=RegisterMap.model_validate({**whole, "heartbeat": None, "exchange": exchange, **spread}))
    if exchange == "read_write":
        # a coupler with function 23 keeps input and readback side by side
        answer = line.respond

        def both(request: ModbusPDU) -> ModbusPDU:
            found: Any = request
            if request.function_code != 23:
                return answer(request) if request.address != 2 else answer_of(line, [1000])
            line.model.write(found.write_address, found.write_registers, line.now_ns)
            return answer_of(line, [0, 1000])

        line.respond = both
        line._framer.decoder.pdu_table[23] = type(line._framer.decoder).pdu_table[23]
    line.driver.open()
    tick(line)
    sent = line.sent
    sample = tick(line, 0.0, 300)
    assert sample.base_m == pytest.approx(0.0, abs=DAC_STEP_M, rel=0.0)
    assert line.sent - sent == 300
    assert line.driver.exchanges == pytest.approx(300 / a_cycle, rel=0.05)


def answer_of(line: StageLine, addresses: list[int]) -> ModbusPDU:
    from pymodbus.pdu.register_message import ReadHoldingRegistersResponse, ReadWriteMultipleRegistersResponse

    words = [word for address in addresses for word in line.model.read(address, 2, line.now_ns)]
    kind = ReadHoldingRegistersResponse if len(addresses) == 1 else ReadWriteMultipleRegistersResponse
    return kind(registers=words)


def test_worked_example_of_a_coupler_is_a_valid_map() -> None:
    found = read_map("wago_750")
    assert found.output.encode(10.0, "big") == (32760,)
    assert found.watchdog is not None
    assert found.watchdog.settings[0].encode(1.0, "big") == (10,)


def test_words_go_in_the_order_of_the_map() -> None:
    register = Register(name="x", address=0, type="float32")
    assert register.encode(1.5, "big") == register.encode(1.5, "little")[::-1] == (0x3FC0, 0)
    assert register.decode((0, 0x3FC0), "little") == 1.5
    with pytest.raises(ValueError, match="does not fit into uint16"):
        Register(name="x", address=0, type="uint16").encode(-1.0, "big")


def test_function_76_has_the_bytes_of_the_manual() -> None:
    conversation = Conversation(1)
    frame = conversation.feedback((Operation(1000, 2, (0x4020, 0)), Operation(0, 2)))
    assert frame.hex() == "00010000000e014c0103e8024020000000000002"
    request = FeedbackRequest()
    request.decode(frame[8:])
    assert request.operations == (Operation(1000, 2, (0x4020, 0)), Operation(0, 2))
    with pytest.raises(FramingError):
        conversation.answer(b"\0" * 12)


@pytest.mark.parametrize(
    ("pdu", "body", "what"),
    [
        (FeedbackRequest, "0003e8", "a frame of function 76 has 3 bytes; its head needs 4"),
        (FeedbackRequest, "000000020103e8024020", "writes 2 registers at 1000, which are 4 bytes; it has 2"),
        (FeedbackRequest, "0203e802", "frame type 2 of function 76 is neither 0 .read. nor 1 .write."),
        (FeedbackAnswer, "402000", "an answer to function 76 has 3 bytes"),
    ],
)
def test_a_body_of_function_76_that_is_cut_is_refused_with_what_it_lacks(
    pdu: type[ModbusPDU], body: str, what: str
) -> None:
    with pytest.raises(FramingError, match=what):
        pdu().decode(bytes.fromhex(body))


def test_node_retracts_when_the_device_is_lost_and_waits_for_arm(bench_of: Any) -> None:
    rig = StageRig(bench_of("afm_node@slave"))
    rig.tick(5)
    rig.control("arm", place="hand")
    rig.tick(400)
    state = rig.bench.take("afm/state")[-1]
    assert (state.v, state.device, state.mode, state.separation_valid) == (1, "ok", "follow", False)
    assert state.base_position_m[2] == pytest.approx(0.0, abs=DAC_STEP_M)
    assert 0.0 < state.sample_age_s < 3e-3
    rig.line.reachable = False
    rig.tick(2)
    assert rig.bench.take("afm/state")[-1].mode == "retracting"
    with pytest.raises(Exception, match="device_lost"):
        rig.tick(200)
        rig.control("arm", place="hand")
    rig.line.reachable = True
    rig.tick(600)
    state = rig.bench.take("afm/state")[-1]
    assert (state.device, state.mode) == ("ok", "retracted")
    # It stays where its own script has made it safe, until a person arms it.
    assert rig.line.model.output_v == 0.0
    rig.control("arm", place="hand")
    rig.tick(5)
    assert rig.bench.take("afm/state")[-1].mode == "follow"
    texts = [event.text for event in rig.bench.take("session/event")]
    assert any("is ready and retracted, calibration t7 470012345" in text for text in texts)
    assert any("device_lost" in text for text in texts)


def test_leaving_retracts_and_reads_it_back(line: StageLine) -> None:
    tick(line)
    tick(line, 10e-9, 200)
    line.driver.close()
    assert line.model.output_v == 0.0
    assert isinstance(line.driver, ModbusAfm)
    with pytest.raises(RuntimeError, match="not open"):
        line.driver.exchange(0.0)
    with pytest.raises(DeviceError):
        StageLine(calibration(stage={"max_v": 4.0}))

"""Each fault of a Modbus instrument on a running node: what driver, bus and device do, and how it goes on."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import pytest
from pymodbus.pdu import ExceptionResponse
from telenano_devices.t7 import t7_model
from telenano_devices.t7.stage_line import PARAMS, StageLine, StageRig
from telenano_devices.t7.t7_server import respond

from services.afm_node.node import AfmNode
from telenano.devices.afm import modbus_line
from telenano.sections.afm_section import AfmConfig
from telenano.wire.errors import ConfigError

MS = 1_000_000

DAC_STEP_V = 5.0 / 4095.0
# a place before the sample, and the voltage there
NEAR_M = -70e-9
NEAR_V = t7_model.REST_V + NEAR_M / t7_model.M_PER_V
RETRACTED_V = t7_model.REST_V + PARAMS.safety.retract_position_m / t7_model.M_PER_V
# of the output in a millisecond and a half, which a cycle of the driver may take, at the speed of the base
STEP_V = 1.5e-3 * PARAMS.safety.base_speed_m_per_s / t7_model.M_PER_V + 2 * DAC_STEP_V
SERIAL, TRIPS = 60028, 46010


def nothing(line: StageLine) -> None:
    """Do nothing."""


class Fault(NamedTuple):
    """A row of the table.

    begin, end: how it comes and goes; text: of the event; status: of the driver and on the bus while it lasts;
    duration_ms: how long; retracts: whether the guard does.
    """

    begin: Callable[[StageLine], None]
    text: str = ""
    status: str = "lost"
    duration_ms: int = 80
    end: Callable[[StageLine], None] = nothing
    retracts: str = "device_lost"


def mended(line: StageLine) -> None:
    line.reachable = line.running = line.accepting = True
    line.respond = lambda request: respond(line.model, request, line.now_ns)
    line.to_host = lambda sent: sent
    line.model._word_swapped = False
    line.model.set_value(SERIAL, float(t7_model.SERIAL))


def answer_exception(code: int) -> Callable[[StageLine], None]:
    def begin(line: StageLine) -> None:
        line.respond = lambda request: ExceptionResponse(request.function_code, code)

    return begin


def stop(line: StageLine) -> None:
    line.running = False


def kill(line: StageLine) -> None:
    line.reachable = False


def interrupt(line: StageLine) -> None:
    """Break the connection; the next one is made at once."""
    line.driver._line = None
    line.driver._lose(line.now_ns, "the connection is gone: Connection reset by peer")


def swallow(line: StageLine) -> None:
    interrupt(line)
    line.accepting = False


def swap_words(line: StageLine) -> None:
    interrupt(line)
    line.model._word_swapped = True


def exchange_device(line: StageLine) -> None:
    interrupt(line)
    line.model.set_value(SERIAL, 5.0)


def exchange_product(line: StageLine) -> None:
    line.model._put(60000, 4.0)


def send(garbage: bytes) -> Callable[[StageLine], None]:
    def begin(line: StageLine) -> None:
        line.to_host = lambda sent: garbage

    return begin


def cut(line: StageLine) -> None:
    line.to_host = lambda sent: sent[:7]


def answer_again(line: StageLine) -> None:
    """Put the answer before in front of each, as a gateway does that gave one up and then had it."""
    before = b""

    def again(sent: bytes) -> bytes:
        nonlocal before
        both, before = before + sent, sent
        return both

    line.to_host = again


def slow_down(line: StageLine) -> None:
    line.latency_ms = 20.0


def speed_up(line: StageLine) -> None:
    line.latency_ms = 0.0


def saturate(line: StageLine) -> None:
    line.model._bridge_v = 0.2
    line.model._move = lambda volts: line.model._put(1000, volts)  # type: ignore[method-assign]


def desaturate(line: StageLine) -> None:
    line.model._bridge_v = 0.0


UNREACHED = "the gateway does not reach the device"
FAULTS: dict[str, Fault] = {
    "exception 1": Fault(answer_exception(1), "illegal function: the device does not know it", end=mended),
    "exception 2": Fault(answer_exception(2), "illegal address: the device has no such register", end=mended),
    "exception 3": Fault(answer_exception(3), "illegal value", end=mended),
    "exception 4": Fault(answer_exception(4), "a coupler whose own watchdog has tripped answers this", end=mended),
    "exception 5": Fault(answer_exception(5), status="stale", duration_ms=25, end=mended, retracts=""),
    "exception 6": Fault(answer_exception(6), status="stale", duration_ms=25, end=mended, retracts=""),
    "exception 10": Fault(answer_exception(10), UNREACHED, end=mended),
    "exception 11": Fault(answer_exception(11), UNREACHED, end=mended),
    "busy for long": Fault(answer_exception(6), "has been silent for 50 ms", duration_ms=120, end=mended),
    "late answer": Fault(answer_again, status="ok", end=mended, retracts=""),
    "garbage": Fault(send(b"HTTP/1.1 400 Bad Request\r\n"), "is not Modbus TCP", end=mended),
    "wrong protocol id": Fault(send(b"\0\1\0\7\0\3\1\3\0"), "protocol id 7", end=mended),
    "half answers": Fault(cut, "has been silent for 50 ms", duration_ms=120, end=mended),
    "words swapped": Fault(swap_words, "TEST reads 5.73768e+08 (0x22330011)", duration_ms=200, end=mended),
    "other serial": Fault(exchange_device, "serial 5 is not that of the calibration", duration_ms=250, end=mended),
    "stopped server": Fault(stop, "has been silent for 50 ms", duration_ms=120, end=mended),
    "killed server": Fault(kill, "the connection is gone: Connection reset by peer", end=mended),
    "blackholed server": Fault(
        swallow, "does not answer: check address, cable and firewall", duration_ms=300, end=mended
    ),
    "slow device": Fault(slow_down, status="stale", duration_ms=200, end=speed_up, retracts=""),
    "input out of range": Fault(saturate, status="ok", end=desaturate, retracts="force_invalid"),
}


@pytest.fixture
def rig(bench_of: Any, monkeypatch: pytest.MonkeyPatch) -> StageRig:
    """Give a node that follows near the sample; a device that is lost is looked for more often."""
    monkeypatch.setattr(modbus_line, "RETRY_NS", 100 * MS)
    monkeypatch.setattr(modbus_line, "STEP_NS", 150 * MS)
    found = StageRig(bench_of("afm_node@slave"))
    approach(found)
    return found


def approach(rig: StageRig) -> None:
    """Arm, and follow to the place near the sample, no faster than the guard lets the base go."""
    rig.tick(3, NEAR_M)
    rig.control("arm", place="hand")
    volts = [rig.line.model.output_v]
    while abs(volts[-1] - NEAR_V) > DAC_STEP_V:
        rig.tick(1, NEAR_M)
        volts.append(rig.line.model.output_v)
        assert len(volts) < 500, volts[-3:]
    assert max(b - a for a, b in pairwise(volts)) <= STEP_V
    rig.tick(1, NEAR_M)
    state = rig.bench.take("afm/state")[-1]
    assert (state.mode, state.device) == ("follow", "ok")


@pytest.mark.parametrize("name", FAULTS)
def test_fault(rig: StageRig, name: str) -> None:
    fault, line = FAULTS[name], rig.line
    exchanges, events, volts = line.driver.exchanges, [], []

    def tick() -> Any:
        rig.tick(1, NEAR_M)
        volts.append(line.model.output_v)
        events.extend(event.text for event in rig.bench.take("session/event"))
        return rig.bench.take("afm/state")[-1]

    rig.node.device_health()
    fault.begin(line)
    states = [tick() for _ in range(fault.duration_ms)]
    # driver
    assert line.driver.report.status == fault.status
    assert any(fault.text in text for text in events) or not fault.text
    # bus
    assert states[-1].device == fault.status
    if fault.retracts:
        assert any(f"the AFM is in mode retracting: {fault.retracts}" in text for text in events)
        assert states[-1].mode in ("retracting", "retracted")
    else:
        assert {state.mode for state in states} == {"follow"}
    # device: the tip, whatever its host knows of it
    if fault.status == "lost":
        assert line.model.output_v == 0.0
        assert line.model.value(TRIPS) == 1.0
    elif fault.retracts:
        assert line.model.output_v == pytest.approx(RETRACTED_V, abs=DAC_STEP_V)
    else:
        assert volts == [pytest.approx(NEAR_V, abs=2 * DAC_STEP_V)] * len(volts)
        assert line.model.value(TRIPS) == 0.0
    if name == "late answer":
        assert line.driver.late_answers > 10
        assert line.driver.exchanges > exchanges + 10
    if name == "slow device":
        assert states[-1].sample_age_s > 19e-3
        assert rig.node.device_health()["device_age_s"] > 15e-3
    # and on it goes: with the tip retracted, until armed
    fault.end(line)
    states, volts[:] = [], []
    while not states or states[-1].device != "ok":
        states.append(tick())
        assert len(states) < 800, events[-3:]
    if not fault.retracts:
        assert {state.mode for state in states} == {"follow"}
        return
    states += [tick() for _ in range(30)]
    assert max(volts) <= RETRACTED_V + 2 * DAC_STEP_V
    assert (states[-1].mode, states[-1].device) == ("retracted", "ok")
    approach(rig)


@pytest.mark.parametrize(
    ("begin", "text"),
    [
        pytest.param(answer_exception(1), r"TEST \(address 55100\): illegal function", id="exception 1"),
        pytest.param(answer_exception(2), r"TEST \(address 55100\): illegal address", id="exception 2"),
        pytest.param(swap_words, r"TEST reads 5.73768e\+08 \(0x22330011\)", id="words swapped"),
        pytest.param(exchange_device, "serial 5 is not that of the calibration", id="other serial"),
        pytest.param(exchange_product, "PRODUCT_ID reads 4 and should read 7", id="other product"),
        pytest.param(stop, "is connected and does not answer requests", id="stopped server"),
        pytest.param(kill, "cannot be reached: Connection refused", id="killed server"),
        pytest.param(swallow, "does not answer: check address, cable and firewall", id="blackholed server"),
    ],
)
def test_refused_start(bench_of: Any, begin: Any, text: str) -> None:
    bench, line = bench_of("afm_node@slave"), StageLine()
    line.model._move(3.0)
    begin(line)
    with pytest.raises(ConfigError, match=text):
        AfmNode(bench.context, AfmConfig(), line.driver)
    assert bench.sent == []
    assert line.model.output_v == pytest.approx(3.0, abs=DAC_STEP_V)

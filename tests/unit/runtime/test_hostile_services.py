"""Every driver that asks and answers against every hostile service: no reading is old and called fresh."""

import shutil
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

if shutil.which("cc") is None:
    pytest.skip("the emulated handle needs a C compiler: apt install gcc libc6-dev", allow_module_level=True)

from telenano_devices.doubles.controller_line import PARAMS, Gwyscope, Nanonis
from telenano_devices.handle.handle_line import HandleLine
from telenano_devices.nanonis.nanonis_driver import FrameLog
from telenano_devices.nanonis.nanonis_model import DEFLECTION
from telenano_devices.t7.stage_line import StageLine

from telenano.devices.hand import wire
from telenano.extend.hands import MODE_OFF, DriveCommand
from telenano.testing import HOSTILITIES, HostileService, TakenReading, unseen

MS = 1_000_000
BEGINS_MS, ENDS_MS = 300, 1200


def between(line: Any, kind: str) -> None:
    """Put a hostile service between a driver and what answers it."""
    hostile = HostileService(kind, line.now_ns + BEGINS_MS * MS)
    receive = "read" if hasattr(line, "read") else "receive"
    come, close = getattr(line, receive), line.close

    def to_host(sent: bytes) -> bytes:
        if sent:
            hostile.put(sent, line.now_ns)
        return b""

    def end() -> None:
        hostile.forget()
        close()

    line.to_host, line.close = to_host, end
    setattr(line, receive, lambda: come() + b"".join(hostile.take(line.now_ns)))


def controller(line: Any, kind: str, taken_s: Callable[[float], float]) -> list[TakenReading]:
    """Run a controller whose deflection tells when it was taken: taken_s maps its voltage to the time [s]."""
    line.driver.open()
    between(line, kind)
    readings = []
    for _ in range(ENDS_MS):
        line.pass_ms(1)
        sample = line.driver.exchange(PARAMS.safety.retract_position_m)
        report = line.driver.report
        true_s = line.now_ns * 1e-9 - taken_s(sample.bridge_voltage_v)
        readings.append(TakenReading(report.age_s, true_s, report.status == "ok"))
    line.driver.close()
    return readings


def gwyscope(kind: str) -> list[TakenReading]:
    line = Gwyscope()
    measure = line.model._measure

    def measured() -> None:
        measure()
        line.model._sample["adc1"] = line.now_ns * 1e-9

    line.model._measure = measured  # type: ignore[method-assign]
    return controller(line, kind, lambda volts: volts)


def nanonis(kind: str) -> list[TakenReading]:
    line = Nanonis()
    values = line.model._now_values
    line.model._now_values = lambda: values() | {DEFLECTION: line.now_ns * 1e-9}  # type: ignore[method-assign]
    step = line.model._step

    def stepped() -> None:
        step()
        line.model._published = line.model._published | {DEFLECTION: line.model._published_ns * 1e-9}

    line.model._step = stepped  # type: ignore[method-assign]
    return controller(line, kind, lambda volts: volts)


def modbus(kind: str) -> list[TakenReading]:
    line = StageLine()
    line.model._move = lambda volts: setattr(line.model, "_bridge_v", 0.01 * line.now_ns * 1e-9)  # type: ignore[method-assign]
    return controller(line, kind, lambda volts: 100.0 * volts)


def handle(kind: str) -> list[TakenReading]:
    line = HandleLine()
    line.driver.open()
    between(line, kind)
    put, sent_ns = line.to_host, {}

    def to_host(sent: bytes) -> bytes:
        for answer in wire.FrameReader().answers(sent):
            sent_ns[answer.seq] = line.now_ns
        return put(sent)

    line.to_host = to_host
    readings = []
    for _ in range(ENDS_MS):
        line.driver.write(DriveCommand(MODE_OFF, 0.0, 0.0))
        line.pass_ms(1)
        line.driver.read(0.1, 1e-3)
        report, state = line.driver.report, line.driver.state
        assert state is not None
        true_s = (line.now_ns - sent_ns.get(state.seq, line.now_ns)) * 1e-9
        readings.append(TakenReading(report.age_s, true_s, report.status == "ok"))
    line.driver.close()
    return readings


DRIVERS = {"gwyscope": gwyscope, "nanonis": nanonis, "modbus": modbus, "handle": handle}


def lost_text(line: HandleLine, latency_ms: Callable[[int], float], count: int) -> str:
    """Let a handle answer ever later, or as it does; return what its driver said."""
    told = ""
    for number in range(count):
        line.latency_ms = latency_ms(number)
        line.driver.write(DriveCommand(MODE_OFF, 0.0, 0.0))
        line.pass_ms(1)
        line.driver.read(0.1, 1e-3)
        told += line.driver.report.text
    line.driver.close()
    return told


def test_a_handle_that_answers_late_or_again_is_lost_with_the_reason() -> None:
    line = HandleLine()
    line.driver.open()
    between(line, "repeated")
    assert "has been silent for 50 ms, but for 5" in lost_text(line, lambda number: 0.0, BEGINS_MS + 100)
    # a queue of the line that grows, and is never silent
    line = HandleLine()
    line.driver.open()
    assert "the handle answers commands of 5" in lost_text(line, lambda number: 0.25 * number, 1000)


def test_a_logger_that_was_held_up_is_read_to_its_newest_frame() -> None:
    """A tick read 4 kB of what waited, and took the newest frame of these for the newest that there is."""
    frame = struct.Struct(">IfQH1f")
    waiting = [b"".join(frame.pack(1, 0.0, n, 4, float(n)) for n in range(first, first + 50)) for first in (0, 50, 100)]
    line: Any = SimpleNamespace(ready=lambda: True, receive=lambda: waiting.pop(0) if waiting else b"")
    log = FrameLog(lambda host, port: line, "", 1)
    log.open()
    assert log.newest() == [149.0]
    waiting.append(frame.pack(1, 0.0, 7, 4, 7.0))
    assert log.newest() is None
    # A stream that never ends has no newest sample.
    line.receive = lambda: frame.pack(1, 0.0, 10**6, 4, 0.0)
    assert log.newest() is None


@pytest.mark.parametrize("kind", HOSTILITIES)
@pytest.mark.parametrize("driver", DRIVERS)
def test_no_reading_is_old_and_called_fresh(driver: str, kind: str) -> None:
    readings = DRIVERS[driver](kind)
    assert not unseen(readings), unseen(readings)[:3]
    # It had a good time before.
    assert sum(found.is_good for found in readings) >= BEGINS_MS

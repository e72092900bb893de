"""Sessions of every driver in virtual time, with devices that answer what no program expects."""

import json
import math
import random
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from telenano_devices.doubles.controller_line import Gwyscope, Nanonis
from telenano_devices.doubles.servo_bench import MemoryConversation, VirtualTime
from telenano_devices.force_dimension import dhd
from telenano_devices.force_dimension.dhd_device import DhdConfig
from telenano_devices.gwyscope import gwyscope_wire
from telenano_devices.handle.handle_line import HandleLine
from telenano_devices.haply import haply
from telenano_devices.haply.haply_device import HaplyConfig
from telenano_devices.haply.haply_service import HaplyService
from telenano_devices.impedance.coupling import ZERO, CouplingSettings
from telenano_devices.impedance.emulated_arm import EmulatedArm
from telenano_devices.impedance.servo import ServoCommand
from telenano_devices.impedance.servo_process import ServoLoop, SharedServo
from telenano_devices.nanonis import nanonis_wire
from telenano_devices.t7.stage_line import StageLine
from telenano_devices.touch import hd
from telenano_devices.touch.hd_device import HdConfig

from telenano.devices.hand import wire
from telenano.extend.hands import MODE_POSITION, DeviceError, DriveCommand
from telenano.extend.instruments import DeviceError as InstrumentError
from telenano.sections.hand_section import HapticConfig

REALS = (math.nan, math.inf, -math.inf, 1e300, -1e300, 5e-324, 0.0, -1.0, 2.0**63)
TICKS = 120


def damaged(source: random.Random, sent: bytes) -> bytes:
    """Return bytes of a stream with some of them changed, lost, doubled or followed by others."""
    data = bytearray(sent)
    for _ in range(source.choice([1, 2, 5])):
        if data:
            data[source.randrange(len(data))] = source.randrange(256)
    cut = source.randrange(len(data) + 1)
    return source.choice([bytes(data), sent[:cut], sent + sent, sent + bytes(data[:cut]), b"", b"HTTP/1.1 400\r\n"])


def _odd_gwyscope(source: random.Random, sent: bytes) -> bytes:
    values = (
        *REALS,
        "",
        "x",
        "read",
        True,
        False,
        -1,
        2**31 - 1,
        np.array([1.0, 2.0]),
        np.array([]),
        np.array([math.nan]),
    )
    message = gwyscope_wire.decode(sent)
    name = source.choice(list(message))
    if source.random() < 0.2:
        del message[name]
    else:
        message[name] = source.choice(values)
    return gwyscope_wire.encode(message)


def _odd_nanonis(source: random.Random, sent: bytes) -> bytes:
    head = nanonis_wire.HEADER.size
    body = bytearray(sent[head:])
    for _ in range(source.choice([1, 1, 3])):
        if len(body) >= 4:
            value = source.choice(
                [struct.pack(">f", r if abs(r) < 3e38 or not math.isfinite(r) else 3e38) for r in REALS]
            )
            at = 4 * source.randrange(len(body) // 4)
            body[at : at + 4] = source.choice([value, b"\xff" * 4, bytes(4), b"\x7f" * 4])
    return sent[:head] + bytes(body)


def _odd_modbus(source: random.Random, sent: bytes) -> bytes:
    body = bytearray(sent[8:])
    if len(body) >= 4:
        at = 2 * source.randrange(len(body) // 2 - 1)
        body[at : at + 4] = source.choice(
            [struct.pack(">f", math.nan), struct.pack(">f", math.inf), b"\xff" * 4, bytes(4)]
        )
    cut = source.choice([len(body), len(body), 2 * source.randrange(len(body) // 2 + 1)])
    body = body[:cut]
    return sent[:4] + struct.pack(">H", 2 + len(body)) + sent[6:8] + bytes(body)


def _odd_handle(source: random.Random, sent: bytes) -> bytes:
    found = []
    for payload in wire.FrameReader().payloads(sent):
        data = bytearray(payload)
        for _ in range(source.choice([1, 2, 5])):
            data[source.randrange(len(data))] = source.choice([0, 0xFF, 0x7F, 0x80, source.randrange(256)])
        found.append(wire.encode_frame(bytes(data)))
    return b"".join(found)


def _often(source: random.Random, odd: Callable[[random.Random, bytes], bytes]) -> Callable[[bytes], bytes]:
    """Return what a hostile line does with what is sent over it: nothing, mostly, or one of both damages."""
    share, after = source.choice([0.01, 0.05, 0.3]), source.choice([0, 5, 30, 80])
    count = 0

    def to_host(sent: bytes) -> bytes:
        nonlocal count
        count += 1
        if count <= after or not sent or source.random() > share:
            return sent
        return source.choice([odd, odd, damaged])(source, sent)

    return to_host


def _controller(build: Callable[[], Any], odd: Callable[[random.Random, bytes], bytes], source: random.Random) -> str:
    line = build()
    line.to_host = _often(source, odd)
    try:
        line.driver.open()
    except InstrumentError as error:
        return str(error)
    told = ""
    places = (-2e-7, -2e-7, -7e-8, 0.0, 1e-8)
    for tick in range(TICKS):
        line.pass_ms(1)
        sample = line.driver.exchange(places[tick // 3 % 5] if tick > 10 else -2e-7)
        report = line.driver.report
        told += report.text if report.status == "lost" and report.text not in told else ""
        assert report.status != "ok" or not report.force_valid or math.isfinite(sample.force_n), sample
        if source.random() < 0.02:
            assert line.driver.retract() in (True, False)
    assert line.driver.retract() in (True, False)
    line.driver.close()
    return told


def _handle(source: random.Random) -> str:
    line = HandleLine()
    line.to_host = _often(source, _odd_handle)
    told = ""
    try:
        line.driver.open()
    except DeviceError as error:
        return str(error)
    for _ in range(TICKS):
        if source.random() < 0.05:
            line.driver.make_safe()
        line.driver.write(DriveCommand(MODE_POSITION, 1e-3, 0.0))
        line.pass_ms(1)
        reading = line.driver.read(0.1, 1e-3)
        assert all(map(math.isfinite, (reading.position_m, reading.velocity_m_per_s, reading.operator_force_n)))
        report = line.driver.report
        told += report.text if report.status == "lost" and report.text not in told else ""
    line.driver.close()
    return told


class OddConversation(MemoryConversation):
    """A service whose JSON has other values, other types, or is none."""

    def __init__(self, source: random.Random, service: HaplyService, time: VirtualTime) -> None:
        super().__init__(service, time)
        self._source, self._share, self._service = source, source.choice([0.02, 0.1, 0.5]), "ws://odd"
        self._messages = self._answers
        self._about, self._decode = haply.INVERSE_SERVICE, haply.DECODE

    receive = haply.Conversation.receive

    def wait(self, patience_s: float = 0.0) -> None:
        self._messages = self._answers
        self._about, self._decode = haply.INVERSE_SERVICE, haply.DECODE
        if not self._answers:
            raise DeviceError("the service has been silent for 0.5 s")
        if self._source.random() > self._share:
            return
        values = (None, "x", [], {}, True, -1, 1e308, -1e308, 5e-324, 2**70)
        document = json.loads(self._answers[0])
        node: Any = document
        while isinstance(node, dict | list) and node:
            key = self._source.choice(list(node) if isinstance(node, dict) else range(len(node)))
            if self._source.random() < 0.3 or not isinstance(node[key], dict | list) or not node[key]:
                node[key] = self._source.choice(values)
                break
            node = node[key]
        text = json.dumps(document)
        self._answers[0] = self._source.choice([text, text, text, text[: self._source.randrange(len(text))], "\xff\0"])


class OddLibrary:
    """A vendor's library that returns any number, and writes any number where it is asked to."""

    def __init__(self, source: random.Random) -> None:
        self._source, self._share = source, source.choice([0.002, 0.02, 0.2])
        self.callback: Callable[[Any], Any] | None = None

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if "telenano" in name:
            raise AttributeError(name)
        return lambda *given: self._call(name, given)

    def _call(self, name: str, given: tuple[Any, ...]) -> Any:
        source = self._source
        odd = source.random() < self._share
        for each in given:
            target = getattr(each, "_obj", each)
            if hasattr(target, "_length_"):
                for place in range(len(target)):
                    real = isinstance(target[place], float)
                    target[place] = (
                        (source.choice(REALS) if real else source.choice([-1, 0, 1, 2**30])) if odd else place == 1
                    )
            elif hasattr(target, "value") and target is not each:
                real = isinstance(target.value, float)
                target.value = (source.choice(REALS) if real else source.choice([-1, 0, 7])) if odd else 0
        if name == "hdGetError":
            return hd.ErrorInfo(source.choice([0, 0x0302, 0xFFFFFFFF]) if odd else 0, 0, 0)
        if name in ("hdGetString", "hdGetErrorString", "dhdGetSystemName", "dhdErrorGetLastStr"):
            return source.choice([None, b"", b"\xff\xfe", b"x" * 1000]) if odd else b"omega.3"
        if name == "hdScheduleAsynchronous":
            self.callback = given[0]
        return source.choice([-1, 0, 1, 2**31 - 1, -(2**31)]) if odd else 0x5000 * (name == "hdCheckCalibration") or 1


def _servo(build: Callable[[VirtualTime, random.Random], Any], source: random.Random) -> str:
    time, shared, told = VirtualTime(), SharedServo(bytearray(SharedServo.SIZE)), ""
    device = build(time, source)
    try:
        found = device.open()
    except DeviceError as error:
        device.close()
        return str(error)
    steps = 0

    def goes_on() -> bool:
        nonlocal steps, told
        steps += 1
        sample = shared.sample()
        told += sample.error if sample is not None and sample.error not in told else ""
        assert sample is None or all(map(math.isfinite, sample.force_n)), sample
        settings = CouplingSettings((0.0, 0.0, 300.0), (0.5, 0.5, 2.0), 3.0, 1000.0)
        shared.write_command(ServoCommand(steps, time.ns, ZERO, ZERO, ZERO, steps > 20, steps // 50, False, settings))
        return steps < 2 * TICKS

    ServoLoop(shared, device, found, now_ns=time.now_ns, sleep=time.sleep, is_needed=goes_on).run()
    return told


def _haply(time: VirtualTime, source: random.Random) -> Any:
    service = HaplyService(EmulatedArm(HapticConfig().operator.to_params(), haply.ARM))
    return haply.HaplyWire(
        HaplyConfig(),
        connect=lambda address: OddConversation(source, service, time),  # type: ignore[arg-type,return-value]
        now_ns=time.now_ns,
        sleep=time.sleep,
    )


def _library(kind: str, time: VirtualTime, source: random.Random) -> Any:
    library = OddLibrary(source)
    if kind == "dhd":
        made: Any = dhd.DhdWire(DhdConfig(), now_ns=time.now_ns, sleep=time.sleep)
    else:
        made = hd.HdWire(HdConfig(), now_ns=time.now_ns, sleep=time.sleep)
    made._lib = library
    if kind == "hd":
        time.passes = lambda duration_s: None if library.callback is None else library.callback(None)
    return made


SESSIONS: dict[str, Callable[[random.Random], str]] = {
    "gwyscope": lambda source: _controller(
        lambda: Gwyscope(guarded=source.random() < 0.3, attended=True), _odd_gwyscope, source
    ),
    "nanonis": lambda source: _controller(
        lambda: Nanonis(guarded=source.random() < 0.3, attended=True), _odd_nanonis, source
    ),
    "modbus": lambda source: _controller(StageLine, _odd_modbus, source),
    "handle": _handle,
    "haply": lambda source: _servo(_haply, source),
    "dhd": lambda source: _servo(lambda time, odd: _library("dhd", time, odd), source),
    "hd": lambda source: _servo(lambda time, odd: _library("hd", time, odd), source),
}


def session(kind: str, seed: int) -> str:
    """Run a session; return what the driver said of its losses. Whatever it raises is a fault of the driver."""
    return SESSIONS[kind](random.Random(f"{kind} {seed}"))

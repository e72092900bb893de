"""A Modbus connection between the driver and the T7 model in virtual time, whose bytes a test can replace."""

from collections.abc import Callable
from typing import Any

import yaml
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from telenano_emulators.t7_model import T7Model, calibration_of
from telenano_emulators.t7_server import respond, served_requests

from services.afm_node.node import AfmNode
from telenano.afm.config import AfmConfig
from telenano.afm.sim import simulated_afm
from telenano.devices.afm.converter_calibration import InstrumentCalibration
from telenano.devices.afm.modbus_driver import ModbusAfm
from telenano.devices.afm.register_map import RegisterMap, read_map
from telenano.settings.config import merge, parse_yaml, validate

MS = 1_000_000
PARAMS = AfmConfig().to_params()


def calibration(**changes: Any) -> InstrumentCalibration:
    document = merge(calibration_of(PARAMS.plant.volts_per_m, PARAMS.plant.stiffness_n_per_m), changes)
    text = yaml.safe_dump(document).encode()
    return validate(InstrumentCalibration, parse_yaml(text, "stage.yaml"), "stage.yaml")


class StageLine:
    """The network, with the device at its end; time passes in `sleep` and `pass_ms`."""

    resolved = True

    def __init__(self, calibrated: InstrumentCalibration | None = None, registers: RegisterMap | None = None) -> None:
        self.now_ns = 10**9
        afm = simulated_afm(PARAMS)
        afm.open()
        self.model = T7Model(afm)
        self.reachable, self.running, self.accepting = True, True, True
        self.latency_ms = 0.0
        # what the device does with a request, and what the network does with the bytes of its answer
        self.respond: Callable[[ModbusPDU], ModbusPDU] = lambda request: respond(self.model, request, self.now_ns)
        self.to_host: Callable[[bytes], bytes] = lambda sent: sent
        self.opened = self.closed = self.sent = 0
        self._waiting: list[tuple[int, bytes]] = []
        decoder = DecodePDU(True)
        for kind in served_requests(lambda request: request):
            decoder.register(kind)
        self._framer: Any = FramerSocket(decoder)
        self.driver = ModbusAfm(
            calibration() if calibrated is None else calibrated,
            read_map("t7") if registers is None else registers,
            PARAMS.safety,
            connect=self._connect,
            now_ns=lambda: self.now_ns,
            sleep=lambda duration_s: self.pass_ms(max(1, round(duration_s * 1e3))),
        )

    def _connect(self, host: str, port: int) -> "StageLine":
        if not self.reachable:
            raise OSError(111, "Connection refused")
        self.opened += 1
        self._waiting.clear()
        return self

    def ready(self) -> bool:
        return self.accepting

    def send(self, request: bytes) -> None:
        if not self.reachable:
            raise OSError(104, "Connection reset by peer")
        self.sent += 1
        if not self.running:
            return
        _, parsed = self._framer.handleFrame(request, 0, 0)
        answer = self.respond(parsed)
        answer.transaction_id, answer.dev_id = parsed.transaction_id, parsed.dev_id
        sent = self.to_host(self._framer.buildFrame(answer))
        self._waiting.append((self.now_ns + round(self.latency_ms * MS), sent))

    def receive(self) -> bytes:
        if not self.reachable:
            raise OSError(104, "Connection reset by peer")
        due = b"".join(sent for at_ns, sent in self._waiting if at_ns <= self.now_ns)
        self._waiting = [(at_ns, sent) for at_ns, sent in self._waiting if at_ns > self.now_ns]
        return due

    def close(self) -> None:
        self.closed += 1

    def pass_ms(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            self.now_ns += MS
            self.model.pass_time(self.now_ns)

    def follow(self, base_m: float, count: int) -> Any:
        """Have the driver follow to a place for a number of periods, and return the last sample."""
        for _ in range(count):
            self.pass_ms(1)
            sample = self.driver.exchange(base_m)
        return sample


class Rig:
    """An AFM node with the T7 model on a bench."""

    def __init__(self, bench: Any) -> None:
        self.bench, self.line = bench, StageLine()
        self.node = AfmNode(bench.context, AfmConfig(), self.line.driver)

    def tick(self, count: int = 1, x_s_m: float = 0.0) -> None:
        for _ in range(count):
            self.bench.advance_ms(1)
            self.line.pass_ms(1)
            fields = {"mode": "position", "base_position_m": (0.0, 0.0, -x_s_m), "hand_seq": 7, "hand_armed": True}
            fields["hand_t_ns"] = self.bench.clock.now_ns()
            self.node.on_message(self.bench.received("afm/command", "controller@slave", **fields))

    def control(self, command: str) -> str:
        fields = {"id": "a", "command": command, "target": "afm_node", "parameters": {}}
        return self.node.on_control(self.bench.make("session/control", "console@slave", **fields))

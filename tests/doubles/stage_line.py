"""A Modbus connection between the driver and the T7 model in virtual time, whose bytes a test can replace."""

from collections.abc import Callable
from typing import Any

import yaml
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from telenano_emulators.t7_model import T7Model, calibration_of
from telenano_emulators.t7_server import respond, served_requests

from telenano.afm.config import AfmConfig
from telenano.afm.sim import simulated_afm
from telenano.devices.afm.converter_calibration import InstrumentCalibration
from telenano.devices.afm.modbus_driver import ModbusAfm
from telenano.devices.afm.register_map import RegisterMap, read_map
from telenano.settings.config import merge, parse_yaml, validate
from telenano.testing import InstrumentRig, RequestLine

PARAMS = AfmConfig().to_params()


def calibration(**changes: Any) -> InstrumentCalibration:
    document = merge(calibration_of(PARAMS.plant.volts_per_m, PARAMS.plant.stiffness_n_per_m), changes)
    text = yaml.safe_dump(document).encode()
    return validate(InstrumentCalibration, parse_yaml(text, "stage.yaml"), "stage.yaml")


class StageLine(RequestLine):
    """A line to the T7 model. respond: what the device does with a request."""

    def __init__(self, calibrated: InstrumentCalibration | None = None, registers: RegisterMap | None = None) -> None:
        super().__init__()
        afm = simulated_afm(PARAMS)
        afm.open()
        self.model = T7Model(afm)
        self.respond: Callable[[ModbusPDU], ModbusPDU] = lambda request: respond(self.model, request, self.now_ns)
        self.sent = 0
        decoder = DecodePDU(True)
        for kind in served_requests(lambda request: request):
            decoder.register(kind)
        self._framer: Any = FramerSocket(decoder)
        self.driver = ModbusAfm(
            calibration() if calibrated is None else calibrated,
            read_map("t7") if registers is None else registers,
            PARAMS.safety,
            **self.clock,
        )

    def send(self, request: bytes) -> None:
        if not self.reachable:
            raise OSError(104, "Connection reset by peer")
        self.sent += 1
        if not self.running:
            return
        _, parsed = self._framer.handleFrame(request, 0, 0)
        answer = self.respond(parsed)
        answer.transaction_id, answer.dev_id = parsed.transaction_id, parsed.dev_id
        self.answer(self._framer.buildFrame(answer))


class Rig(InstrumentRig):
    """An AFM node with the T7 model on a bench."""

    def __init__(self, bench: Any) -> None:
        super().__init__(bench, StageLine())

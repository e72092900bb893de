"""A wire in virtual time between the driver of the stage and the T7 model; a test can replace its bytes."""

from collections.abc import Callable
from typing import Any

from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

from telenano.afm import simulated_afm
from telenano.devices import InstrumentCalibration, ModbusAfm, read_map
from telenano.sections import AfmConfig
from telenano.settings import merge, validate
from telenano.testing import InstrumentRig, NodeBench, RequestLine
from telenano_devices.t7.t7_model import T7Model, calibration_of
from telenano_devices.t7.t7_server import respond, served_requests

PARAMS = AfmConfig().to_params()


def calibration(**changes: Any) -> InstrumentCalibration:
    """Return the calibration of the emulated stage, with changes to some keys."""
    document = merge(calibration_of(PARAMS.plant.volts_per_m, PARAMS.plant.stiffness_n_per_m), changes)
    return validate(InstrumentCalibration, document, "stage.yaml")


class StageLine(RequestLine):
    """A wire to the T7 model; a test may replace `respond`, the function that answers a request.

    Args:
        calibrated: The calibration of the driver; None for that of the emulated stage.
        registers: The register map of the driver; None for that of the T7.
    """

    def __init__(self, calibrated: InstrumentCalibration | None = None, registers: Any = None) -> None:
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


class StageRig(InstrumentRig):
    """An AFM node with the T7 model on a bench."""

    def __init__(self, bench: NodeBench) -> None:
        super().__init__(bench, StageLine())

"""Fig. 12 by an emulated Nanonis in virtual time: forces and places beside those of the simulated instrument.

A Gwyscope gives the forces of the simulated instrument to a millionth, by the tests of its driver.
"""

from typing import Any

import numpy as np
import pytest
import yaml
from telenano_devices.nanonis import nanonis_model
from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration
from telenano_devices.nanonis.nanonis_driver import NanonisAfm

import services.afm_node.__main__ as afm
from telenano.devices.afm.instrument import driver_of
from telenano.sections.afm_section import AfmConfig
from telenano.settings import find_scenario
from telenano.settings.config import validate
from telenano.virtual import VirtualRig, constant_timing

TIP, HAND = "afm_node@slave", "haptic_node@master"
BEGIN_S, END_S = 0.4, 4.4
# states in the holds of 1 and of 2 N
FIRST, SECOND = (2400, 2600), (4200, 4700)
TIMING = constant_timing(None, 100_000)


class Wire:
    """The connection to an emulated controller, at the time of a rig."""

    resolved = True

    def __init__(self, config: AfmConfig) -> None:
        self.now_ns = 0
        self._answers: list[bytes] = []
        instrument = driver_of(config)
        instrument.open()
        plant = config.to_params().plant
        document = nanonis_model.calibration_of(plant.volts_per_m, plant.stiffness_n_per_m)
        calibration = validate(NanonisCalibration, document, "nanonis")
        self.model = nanonis_model.NanonisModel(instrument)
        clock: dict[str, Any] = {"connect": lambda host, port: self, "now_ns": lambda: self.now_ns, "sleep": self.sleep}
        self.driver = NanonisAfm(calibration, config.to_params().safety, attended=True, **clock)

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)

    def ready(self) -> bool:
        return True

    def send(self, request: bytes) -> None:
        self._answers.append(self.model.serve(request, self.now_ns) or b"")

    def receive(self) -> bytes:
        return self._answers.pop(0) if self._answers else b""

    def close(self) -> None:
        self._answers.clear()


def session(monkeypatch: pytest.MonkeyPatch, *, is_emulated: bool) -> tuple[Any, Any]:
    """Run the hand of Fig. 12 for five seconds; return what tip and hand said in it."""
    scenario = yaml.safe_load(find_scenario("fig12").read_text()) | {"duration_s": 60.0}
    scenario["controller"] = {"law": "model_mediated"}
    wires: list[Wire] = []

    def driver(config: AfmConfig, period_s: float) -> Any:
        if not is_emulated:
            return driver_of(config, period_s)
        wires.append(Wire(config))
        return wires[0].driver

    with monkeypatch.context() as patch:
        patch.setattr(afm, "driver_of", driver)
        rig = VirtualRig(None, 1, (), TIMING, scenario)
    try:
        if wires:
            wire, usual = wires[0], wires[0].driver.exchange
            ahead_ns = wire.now_ns - rig.clock.monotonic_ns()

            def exchange(base_m: float) -> Any:
                wire.now_ns = max(wire.now_ns, rig.clock.monotonic_ns() + ahead_ns)
                return usual(base_m)

            monkeypatch.setattr(wire.driver, "exchange", exchange)
        rig.run_until(0.2)
        rig.command("arm", "*", place="hand")
        rig.run_until(BEGIN_S)
        rig.command("start", HAND)
        rig.run_until(BEGIN_S + END_S)
        return rig.received("afm/state", TIP), rig.received("haptic/state", HAND)
    finally:
        rig.close()


def held(tips: Any, begin: int, end: int) -> float:
    """Return the mean force on the tip in some of the states [N]."""
    return float(np.mean([tip.tip_force_n[2] for tip in tips[begin:end]]))


@pytest.mark.endurance
def test_fig12_by_a_nanonis_presses_no_harder_and_costs_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that values of a Tap correct is met later, so the hand stands deeper: that is what it costs."""
    simulated, _ = session(monkeypatch, is_emulated=False)
    tips, hands = session(monkeypatch, is_emulated=True)
    assert {(tip.mode, tip.device) for tip in tips} <= {("retracted", "ok"), ("follow", "ok")}
    assert held(tips, *SECOND) == pytest.approx(held(simulated, *SECOND), rel=0.05)
    most = [max(tip.tip_force_n[2] for tip in found) for found in (tips, simulated)]
    assert most[0] < 1.1 * most[1]
    # and it does not swing: the hand stands, and the force of the tip within a nanonewton
    assert np.ptp([hand.position_m[2] for hand in hands[-300:]]) < 1e-5
    assert np.std([tip.tip_force_n[2] for tip in tips[SECOND[0] : SECOND[1]]]) < 1e-9

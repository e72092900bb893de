"""The fast path: a T7 at the external input of an emulated Nanonis, driven while the controller is asked over its wire.

The rig's driver is that of the T7; the controller approaches and withdraws by its own commands. One instrument
is behind both, in virtual time.
"""

from typing import Any

import numpy as np
import pytest
from telenano_devices.doubles.controller_line import Nanonis
from telenano_devices.nanonis import nanonis_client, nanonis_model, nanonis_wire
from telenano_devices.nanonis.nanonis_client import approach
from telenano_devices.nanonis.nanonis_model import ExternalInput
from telenano_devices.t7.stage_line import PARAMS, StageRig
from telenano_devices.t7.t7_model import T7Model

from telenano.afm.sim import simulated_afm
from telenano.extend.instruments import DeviceError

# The node leaves the base where a T7 that it meets has made it safe, at -200 nm, so this leaves 10 nm at 0.
LIFT_M, SETPOINT_V = 210e-9, 5e-3
CONTACT_M = 11e-9


class Both:
    """A node on a T7 behind which is a Nanonis; its clock is that of both, and of a client of the controller."""

    def __init__(self, bench: Any) -> None:
        self.nanonis = Nanonis(guarded=False)
        # a quicker z-controller than the emulator's usual one, for a shorter approach
        self.nanonis.model._values["ZCtrl.Gain"] = [2e-7, 1e-3, 2e-4]
        self.rig = StageRig(bench)
        stage = self.rig.line
        usual = stage.pass_ms

        def pass_ms(duration_ms: int) -> None:
            for _ in range(duration_ms):
                usual(1)
                self.nanonis.pass_ms(1)

        stage.pass_ms = pass_ms  # type: ignore[method-assign]
        # the node is connected to the T7 that is there first, and then to this one
        stage.model = T7Model(ExternalInput(self.nanonis.model))
        stage.driver.close()
        stage.driver.open()

    def call(self, command: str, *arguments: Any) -> list[Any]:
        """Ask the controller, as `NanonisClient` does."""
        answer = self.nanonis.served(nanonis_wire.request(command, *arguments), self.nanonis.now_ns)
        try:
            return nanonis_wire.returned(command, answer or b"")
        except nanonis_wire.NanonisRefusalError as error:
            raise DeviceError(str(error)) from error

    def now_s(self) -> float:
        return self.nanonis.now_ns * 1e-9

    def sleep(self, seconds: float) -> None:
        self.rig.tick(round(seconds * 1e3))

    def approach(self) -> float:
        return approach(self, SETPOINT_V, LIFT_M)  # type: ignore[arg-type]

    def states(self) -> list[Any]:
        return list(self.rig.bench.take("afm/state"))


@pytest.fixture
def both(bench_of: Any) -> Both:
    return Both(bench_of("afm_node@slave"))


@pytest.mark.check("takes 1.2 s")
def test_the_controller_approaches_and_the_rig_feels_the_sample_through_the_t7(both: Both) -> None:
    both.rig.tick(30)
    z_m = both.approach()
    assert both.call("ZCtrl.StatusGet") == [nanonis_model.OFF]
    assert z_m == pytest.approx(0.0, abs=3e-9)
    both.rig.control("arm", place="hand")
    same = simulated_afm(PARAMS)
    same.open()
    worst_n = 0.0
    for base_m in (*np.linspace(-100e-9, CONTACT_M, 20), *np.linspace(CONTACT_M, 0.0, 10)):
        both.rig.tick(60, float(base_m))
        state = both.states()[-1]
        assert state.mode == "follow"
        # the force is that of the sum of both motions
        expected = same.exchange(0.0 - state.base_position_m[2] - z_m)
        worst_n = max(worst_n, abs(state.tip_force_n[2] - expected.force_n))
    assert worst_n < 0.1e-9
    # the controller has moved nothing meanwhile
    assert both.call("ZCtrl.ZPosGet") == [pytest.approx(z_m, abs=1e-12)]


@pytest.mark.endurance
def test_either_of_the_two_takes_the_tip_away_without_the_other(both: Both) -> None:
    both.rig.tick(30)
    z_m = both.approach()
    both.rig.control("arm", place_m=CONTACT_M, speed_m_per_s=2e-6)
    both.rig.tick(400, CONTACT_M)
    assert both.states()[-1].in_contact
    # the rig dies: the script on the T7 retracts, and the controller stays where it is
    both.rig.line.pass_ms(100)
    assert both.rig.line.model.output_v == 0.0
    assert both.call("ZCtrl.ZPosGet") == [pytest.approx(z_m, abs=1e-12)]
    both.rig.tick(900)
    both.rig.control("arm", place_m=CONTACT_M, speed_m_per_s=2e-6)
    both.rig.tick(400, CONTACT_M)
    assert both.states()[-1].in_contact
    # a person withdraws at the controller: the tip is free whatever the rig sends
    both.call("ZCtrl.Withdraw", 0, -1)
    both.rig.tick(60, CONTACT_M)
    state = both.states()[-1]
    assert (state.mode, state.in_contact) == ("follow", False)
    assert abs(state.tip_force_n[2]) < 1e-10


@pytest.mark.endurance
def test_a_surface_that_is_not_found_ends_the_approach_withdrawn(both: Both, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nanonis_client, "_REST_WITHIN_S", 1.0)
    both.rig.tick(30)
    with pytest.raises(DeviceError, match="z did not come to rest within 1 s"):
        both.approach()
    both.rig.tick(30)
    assert both.call("ZCtrl.ZPosGet")[0] > 9.9e-7

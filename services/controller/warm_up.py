"""One call of every step of a law, so that none is compiled or specialised when the first tick needs it."""

from typing import Any

from services.controller import energy
from services.controller.clamp import clamped
from services.controller.config import ControllerConfig
from services.controller.deadband import deadband, initial_deadband_state
from services.controller.law import NO_TIP, HandSample, Law, SlaveReference


def warm_up(law: Law, params: Any, config: ControllerConfig) -> None:
    """Compile the steps of a law before the first tick needs them."""
    period_s = config.period_s
    hand, tip = HandSample(0.0, 0.0, 0.0, False), NO_TIP
    state = law.master_resume(params, hand, 0.0)
    state, signal = law.master_send(params, law.master_start(params, hand), hand, period_s)
    state, _ = law.master_receive(params, state, hand, signal, period_s)
    law.master_energy_account(params, state)
    slave, _ = law.slave_receive(params, law.slave_start(params, tip), signal, tip, period_s)
    slave, _ = law.slave_send(params, slave, tip, period_s)
    energy.is_passive(0.0, False, law.slave_energy_account(params, slave))
    law.retune(params, params, state)
    deadband(config.deadband.to_params(), initial_deadband_state(signal), signal, period_s)
    clamped(config.clamp_params(), SlaveReference(0.0, True), signal, tip)
    port = energy.moved_to(energy.opened(0.0, 0.0), 0.0, 0.0)
    energy.with_inflow(port, 0.0, 0.0)
    energy.with_outflow(port, 0.0, 0.0)

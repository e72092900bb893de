"""The critical round trip on the spring with a real driver in the loop, against theory with the declared latency."""

import math
from collections import deque
from typing import NamedTuple

import pytest
from telenano_devices.t7.stage_line import StageLine, calibration
from telenano_devices.t7.t7_model import T7Model
from telenano_lab.studies.loops.theory import critical_link_delay_s, loop_model

from telenano.extend.laws import NO_SIGNAL, HandSample, TipMeasurement
from telenano.sections.controller_section import ControllerConfig

PERIOD_S = 1e-3
SPRING_N_PER_M = 38.0
CANTILEVER_N_PER_M = 40.0
V_PER_M = 1e7
HAND_N = 8.0
# so fine that a motion which dies out is not lost in the steps: the linear theory knows none
STEP_V = 1e-5


class Volts(NamedTuple):
    bridge_voltage_v: float


class Spring:
    """F = K x_s, as the bridge of a cantilever would show it."""

    def exchange(self, base_m: float) -> Volts:
        return Volts(SPRING_N_PER_M * base_m / CANTILEVER_N_PER_M * V_PER_M)


def growth_per_s(round_trip: int, cycle_s: float) -> float:
    """Return the growth rate of what is left of a step of the hand, over a link of so many periods [1/s]."""
    config = ControllerConfig(law="virtual_impedance")
    law, params = config_law(config)
    found = calibration(
        cantilever={"stiffness_n_per_m": CANTILEVER_N_PER_M},
        deflection={"v_per_m": V_PER_M, "range_v": 1.0},
    )
    line = StageLine(found)
    line.model = T7Model(Spring(), output_step_v=STEP_V)
    line.latency_ms = 1e3 * cycle_s
    line.driver.open()
    for _ in range(5):
        line.pass_ms(1)
        line.driver.exchange(-150e-9)
    for _ in range(300):
        line.pass_ms(1)
        sample = line.driver.exchange(0.0)
    tip = TipMeasurement(sample.base_m, 0.0, 0.0, False, False, True, 0.0)
    hand = HandSample(0.0, 0.0, 0.0, True)
    master, slave = law.master_start(params, hand), law.slave_start(params, tip)
    forward = deque([NO_SIGNAL] * (round_trip // 2))
    backward = deque([NO_SIGNAL] * (round_trip - round_trip // 2))
    forces: list[float] = []
    for tick in range(3800):
        hand = HandSample(master.position_m, 0.0, HAND_N if tick > 100 else 0.0, True)
        master, signal = law.master_send(params, master, hand, PERIOD_S)
        forward.append(signal._replace(silence_s=0.0))
        slave, reference = law.slave_receive(params, slave, forward.popleft(), tip, PERIOD_S)
        line.pass_ms(1)
        sample = line.driver.exchange(reference.position_m)
        tip = TipMeasurement(sample.base_m, sample.force_n, 0.0, False, False, True, 0.0)
        slave, answer = law.slave_send(params, slave, tip, PERIOD_S)
        backward.append(answer._replace(silence_s=0.0))
        master, _ = law.master_receive(params, master, hand, backward.popleft(), PERIOD_S)
        forces.append(sample.force_n)
    return math.log(swing(forces[2300:3800]) / swing(forces[800:2300])) / 1.5


def config_law(config: ControllerConfig) -> tuple[object, object]:
    from telenano.sections.controller_section import LAWS

    return LAWS[config.law], config.params()


def swing(forces: list[float]) -> float:
    mean = math.fsum(forces) / len(forces)
    return math.sqrt(math.fsum((force - mean) ** 2 for force in forces) / len(forces))


@pytest.mark.endurance
@pytest.mark.parametrize("cycle_s", [0.4e-3, 1.2e-3, 2.6e-3])
def test_critical_round_trip_is_that_of_theory_less_the_declared_latency(cycle_s: float) -> None:
    config = ControllerConfig(law="virtual_impedance")
    model = loop_model(config.law, config.law_config(), SPRING_N_PER_M)
    assert model is not None
    bears_s = critical_link_delay_s(model, PERIOD_S)
    from telenano.devices.afm.register_map import read_map

    registers = read_map("t7").model_copy(update={"device_cycle_s": cycle_s})
    latency_s = StageLine(registers=registers).driver.latency_s
    expected = (bears_s - latency_s) / PERIOD_S
    low, high = math.floor(expected) - 1, math.ceil(expected) + 1
    growths = growth_per_s(low, cycle_s), growth_per_s(high, cycle_s)
    assert growths[0] < 0.0 < growths[1]
    critical = low + (high - low) * -growths[0] / (growths[1] - growths[0])
    # of the whole loop, as theory counts it
    assert critical * PERIOD_S + latency_s == pytest.approx(bears_s, rel=0.05, abs=0.0)

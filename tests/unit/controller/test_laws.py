"""What every law of the table keeps to."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from services.controller.config import LAWS, ControllerConfig
from services.controller.law import NO_SIGNAL, HandSample, TipMeasurement

T = 1e-3
HAND = HandSample(5e-3, 0.01, 0.7, True)
TIP = TipMeasurement(1.1e-8, 7e-9, 1e-10, True, True, True)


def params_of(name: str, **parameters: Any) -> Any:
    return ControllerConfig.model_validate({"law": name, name: parameters}).params()


@pytest.mark.parametrize("name", LAWS)
def test_table_config_and_section_agree(name: str) -> None:
    config = ControllerConfig.model_validate({"law": name})
    assert LAWS[name].name == name
    assert type(config.law_config()) is LAWS[name].config
    assert (config.law_config().position_scale, config.law_config().force_scale) == (1.5e-6, 1e8)


def test_no_two_laws_share_a_class_of_parameters() -> None:
    assert len({type(params_of(name)) for name in LAWS}) == len(LAWS)


@pytest.mark.parametrize("name", LAWS)
def test_law_that_takes_over_moves_neither_hand_nor_tip(name: str) -> None:
    law, params = LAWS[name], params_of(name)
    state = law.master_resume(params, HAND, TIP.base_position_m)
    state, forward = law.master_send(params, state, HAND, T)
    assert abs(forward.position_m - TIP.base_position_m) < 1e-20
    slave = law.slave_start(params, TIP)
    slave, wanted = law.slave_receive(params, slave, forward._replace(active=False), TIP, T)
    assert abs(wanted.position_m - TIP.base_position_m) < 1e-20
    answer = law.slave_send(params, slave, TIP, T)[1]
    assert abs(answer.position_m - TIP.base_position_m) < 1e-20
    _, reference = law.master_receive(params, state, HAND, answer._replace(silence_s=0.0), T)
    # the hand goes on: no further than its speed and the force of 10 N take it in a period
    assert reference.active
    assert abs(reference.position_m - HAND.position_m) < 2.5e-5
    assert abs(reference.velocity_m_per_s - HAND.velocity_m_per_s) < 0.05


@pytest.mark.parametrize("name", LAWS)
def test_first_coupled_tick_of_the_slave_does_not_jump(name: str) -> None:
    law, params = LAWS[name], params_of(name)
    state = law.slave_start(params, TIP)
    signal = NO_SIGNAL._replace(position_m=TIP.base_position_m, force_n=7e-9, energy_j=0.3, active=True, silence_s=0.0)
    _, wanted = law.slave_receive(params, state, signal, TIP, T)
    # what a contact force of 0.7 N at the hand's scale moves a base through the damper of its law in a period
    assert abs(wanted.position_m - TIP.base_position_m) < 0.7 / 30.0 * T * 1.5e-6 * 1.001


class Bench:
    """Both halves of a law over a link without delay, a hand of 1 N, and a spring of 20 N/m under the tip."""

    def __init__(self, name: str) -> None:
        self.law, self.params = LAWS[name], params_of(name)
        self.x, self.tip = 0.0, TipMeasurement(0.0, 0.0, 0.0, False, False, False)
        self.master = self.law.master_start(self.params, HandSample(0.0, 0.0, 0.0, True))
        self.slave = self.law.slave_start(self.params, self.tip)

    def run(
        self, ticks: int, force_n: float, *, off: bool = False, retracted: bool = False
    ) -> list[tuple[float, float]]:
        """Give the hand's position [m] and the tip's force [N] of each tick; off: the hand; retracted: the tip."""
        rows = []
        for _ in range(ticks):
            hand = HandSample(self.x, 0.0, force_n, not off)
            self.master, signal = self.law.master_send(self.params, self.master, hand, T)
            self.slave, wanted = self.law.slave_receive(
                self.params, self.slave, signal._replace(silence_s=0.0), self.tip, T
            )
            base = 0.0 if retracted else wanted.position_m
            self.tip = TipMeasurement(base, 20.0 * base, 0.0, False, base != 0.0, not retracted)
            self.slave, answer = self.law.slave_send(self.params, self.slave, self.tip, T)
            self.master, reference = self.law.master_receive(
                self.params, self.master, hand, answer._replace(silence_s=0.0), T
            )
            self.x = self.x if off else reference.position_m
            rows.append((self.x, self.tip.force_n))
        return rows


@pytest.mark.parametrize("name", LAWS)
def test_session_after_a_new_arming_is_as_the_first(name: str) -> None:
    bench = Bench(name)
    bench.run(20, 0.0, retracted=True)
    first = bench.run(400, 1.0)
    # the device is off while the hand moves, so that hand and tip part; then the tip retracts and the hand goes back
    bench.run(520, 1.0, off=True)
    bench.x += 1e-3
    bench.run(50, 1.0)
    bench.run(20, 0.0, off=True, retracted=True)
    bench.x = 0.0
    bench.run(150, 0.0, off=True, retracted=True)
    again = bench.run(400, 1.0)
    np.testing.assert_allclose(again, first, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("period_s", [5e-4, 2e-3])
def test_every_law_holds_a_spring_at_other_periods(name: str, period_s: float) -> None:
    law = LAWS[name]
    params = ControllerConfig.model_validate({"law": name, "period_s": period_s}).params()
    x, base = 0.0, 0.0
    tip = TipMeasurement(0.0, 0.0, 0.0, False, True, True)
    master, slave = law.master_start(params, HandSample(0.0, 0.0, 0.0, True)), law.slave_start(params, tip)
    answer = NO_SIGNAL
    for _ in range(round(4.0 / period_s)):
        hand = HandSample(x, 0.0, 1.0, True)
        master, signal = law.master_send(params, master, hand, period_s)
        slave, wanted = law.slave_receive(params, slave, signal._replace(silence_s=0.0), tip, period_s)
        base = wanted.position_m
        tip = TipMeasurement(base, 20.0 * base, 0.0, False, True, True)
        slave, answer = law.slave_send(params, slave, tip, period_s)
        master, reference = law.master_receive(params, master, hand, answer._replace(silence_s=0.0), period_s)
        x = reference.position_m
    assert 1e8 * tip.force_n == pytest.approx(1.0, rel=0.06, abs=0.0)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"position_scale": 0.0}, "greater than or equal to"),
        ({"force_scale": -1.0}, "greater than or equal to"),
        ({"silence_limit_s": float("nan")}, "finite"),
        ({"wishes": 1.0}, "Extra inputs"),
        ({"mass_kg": 0.0}, "greater than or equal to"),
    ],
)
def test_bad_parameters_are_refused(name: str, parameters: dict[str, float], text: str) -> None:
    with pytest.raises(ValidationError, match=text) as caught:
        params_of(name, **parameters)
    assert next(iter(parameters)) in str(caught.value)


def test_unknown_law_is_refused() -> None:
    with pytest.raises(ValidationError, match="model_mediated"):
        ControllerConfig.model_validate({"law": "telepathy"})


@pytest.mark.parametrize("name", [*LAWS, "deadband"])
def test_every_parameter_is_documented(name: str) -> None:
    text = (Path(__file__).parents[3] / "docs" / "laws.md").read_text(encoding="utf-8")
    model = ControllerConfig.model_fields[name].annotation
    assert f"\n## {name}\n" in text
    assert isinstance(model, type)
    missing = [field for field in model.model_fields if f"`{field}`" not in text]
    assert not missing

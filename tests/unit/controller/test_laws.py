"""What every law of the table keeps to."""

from pathlib import Path
from typing import Any

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

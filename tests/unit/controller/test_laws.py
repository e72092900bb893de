"""What every law of the table keeps to."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from services.controller.config import LAWS, ControllerConfig
from services.controller.law import HandSample, MasterReference, PortSignal, SlaveReference, TipMeasurement
from services.controller.law_rules import RULES, broken_rules


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
def test_the_law_keeps_the_rules_that_the_rig_relies_on(name: str) -> None:
    # the corners of the ranges have tests of their own
    rules = [rule for rule in RULES if rule.name != "gives numbers at the corners of every range"]
    assert {rule.name: faults for rule in rules if (faults := list(rule.broken_by(name)))} == {}
    assert len(rules) == 7


def jumping(params: Any, state: Any, hand: HandSample, signal: PortSignal, dt: float) -> tuple[Any, MasterReference]:
    return state, MasterReference(hand.position_m + 1e-3, 0.0, 0.0, True)


def drifting(params: Any, state: Any, signal: PortSignal, tip: TipMeasurement, dt: float) -> tuple[Any, SlaveReference]:
    return state, SlaveReference(tip.base_position_m + 1e-9, True)


def test_a_law_that_breaks_a_rule_is_told_which_and_how(monkeypatch: pytest.MonkeyPatch) -> None:
    own = LAWS["position_force"]
    monkeypatch.setitem(LAWS, "position_force", replace(own, master_receive=jumping, slave_receive=drifting))
    broken = broken_rules("position_force")
    assert broken["takes over without moving hand or tip"] == [
        "slave_receive: the base goes to 1.2e-08 m before the law is coupled",
        "master_receive: the hand's reference jumps by 0.001 m",
    ]
    assert "base jumps by 1e-09 m" in broken["begins without a jump of the tip"][0]
    assert "the hand is held" in broken["lets the hand go while the other half is silent"][0]
    assert len(broken["holds a spring without delay"]) == 3
    assert broken["settings have defaults, ranges and descriptions"] == []


def test_a_law_that_fails_is_a_finding_and_not_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*arguments: Any) -> Any:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setitem(LAWS, "position_force", replace(LAWS["position_force"], master_send=failing))
    assert broken_rules("position_force")["takes over without moving hand or tip"] == [
        "fails: ZeroDivisionError: float division by zero"
    ]


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

"""What every law of the table keeps to."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from telenano.extend import pass_through
from telenano.extend.laws import (
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    SlaveReference,
    TipMeasurement,
    checked_law,
    measured_tip,
    no_energy_account,
    the_hands_force,
)
from telenano.laws import virtual_impedance, wave
from telenano.lockstep.law_rules import RULES, broken_rules
from telenano.sections.controller_section import KNOWN_LAWS, LAWS, OWN_LAWS, ControllerConfig
from telenano.sections.law_names import LAW_NAMES
from telenano.sections.own_laws import WaveConfig

T = 1e-3


def params_of(name: str, **parameters: Any) -> Any:
    return ControllerConfig.model_validate({"law": name, name: parameters}).params()


@pytest.mark.parametrize("name", OWN_LAWS)
def test_table_config_and_section_agree(name: str) -> None:
    config = ControllerConfig.model_validate({"law": name})
    assert LAWS[name].name == name
    assert type(config.law_config()) is LAWS[name].config
    assert (config.law_config().position_scale, config.law_config().force_scale) == (1.5e-6, 1e8)


def test_names_that_need_no_law_are_those_of_the_table() -> None:
    assert tuple(OWN_LAWS) == LAW_NAMES


def test_table_is_made_of_the_steps_that_a_module_has() -> None:
    law = LAWS["wave"]
    assert law == Law(
        name="wave", config=WaveConfig, master_start=wave.master_start, master_resume=wave.master_resume,
        master_send=wave.master_send, master_receive=wave.master_receive, slave_start=wave.slave_start,
        slave_receive=wave.slave_receive, slave_send=wave.slave_send, retune=wave.retune,
        master_energy_account=wave.master_energy_account, slave_energy_account=wave.slave_energy_account,
        uses_waves=True, uses_energy=True, local_loop=True, passive=True, slave_retune=wave.slave_retune,
        fixed_in_contact=("impedance_n_s_per_m",), rest_force=the_hands_force,
    )  # fmt: skip
    plain = LAWS["virtual_impedance"]
    assert (plain.slave_start, plain.slave_receive, plain.slave_send) == (
        pass_through.slave_start, pass_through.slave_receive, measured_tip,
    )  # fmt: skip
    assert plain.master_energy_account is plain.slave_energy_account is no_energy_account
    assert not (plain.uses_waves or plain.uses_energy or plain.local_loop or plain.passive)
    assert plain.link_loop


def test_a_law_says_whether_it_closes_a_loop_what_it_promises_and_what_it_must_know() -> None:
    assert {name for name, law in KNOWN_LAWS.items() if not law.link_loop} >= {"model_mediated", "tactile"}
    assert {name for name, law in OWN_LAWS.items() if law.passive} == {"wave", "passivity"}
    assert LAWS["model_mediated"].must_know == ("cantilever_stiffness_n_per_m",)
    unknown = replace(LAWS["wave"], must_know=("mood",))
    with pytest.raises(ValueError, match="its settings have no mood, which must_know names"):
        checked_law("wave", unknown)


def test_law_without_a_step_is_not_made() -> None:
    with pytest.raises(AttributeError, match="master_start"):
        Law.of(__name__, WaveConfig)
    with pytest.raises(AttributeError, match="slave_start"):
        Law.of(wave.__name__, WaveConfig, slave=virtual_impedance)


def test_no_two_laws_share_a_class_of_parameters() -> None:
    assert len({type(params_of(name)) for name in LAWS}) == len(LAWS)


@pytest.mark.check("takes 3.4 s")
@pytest.mark.parametrize("name", OWN_LAWS)
def test_the_law_keeps_the_rules_that_the_rig_relies_on(name: str) -> None:
    # the corners of the ranges have tests of their own
    rules = [rule for rule in RULES if rule.name != "gives numbers at the corners of every range"]
    assert {rule.name: faults for rule in rules if (faults := list(rule.broken_by(name)))} == {}
    assert len(rules) == 10


class Bench:
    """Both halves of a law over a link without delay, a hand of 1 N, and a spring of 20 N/m under the tip."""

    def __init__(self, name: str) -> None:
        self.law, self.params = LAWS[name], params_of(name)
        self.x, self.tip = 0.0, TipMeasurement(0.0, 0.0, 0.0, False, False, False, 0.0)
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
            self.tip = TipMeasurement(base, 20.0 * base, 0.0, False, base != 0.0, not retracted, 0.0)
            self.slave, answer = self.law.slave_send(self.params, self.slave, self.tip, T)
            self.master, reference = self.law.master_receive(
                self.params, self.master, hand, answer._replace(silence_s=0.0), T
            )
            self.x = self.x if off else reference.position_m
            rows.append((self.x, self.tip.force_n))
        return rows


@pytest.mark.parametrize("name", OWN_LAWS)
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


@pytest.mark.parametrize("name", OWN_LAWS)
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
    with pytest.raises(ValidationError, match="passivity"):
        ControllerConfig.model_validate({"law": "telepathy"})


@pytest.mark.parametrize("name", [*OWN_LAWS, "deadband"])
def test_every_parameter_is_documented(name: str) -> None:
    text = (Path(__file__).parents[3] / "docs" / "laws.md").read_text(encoding="utf-8")
    model = ControllerConfig.model_fields[name].annotation
    assert f"\n## {name}\n" in text
    assert isinstance(model, type)
    missing = [field for field in model.model_fields if f"`{field}`" not in text]
    assert not missing, f"docs/laws.md does not say what these keys of controller.{name} do: {', '.join(missing)}"

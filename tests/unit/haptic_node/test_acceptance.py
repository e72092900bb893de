"""The acceptance of a device: a good one passes, and each check finds the fault that it is for."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from proto.errors import ConfigError
from services.haptic_node.acceptance.checks import CHECKS, Verdict, overall, verdicts_of
from services.haptic_node.acceptance.devices import Circumstances, make_take
from services.haptic_node.acceptance.take import MASS_STEP, MOST_WITHOUT_STOP_N, STEPS, Take, read_take, steps_of
from services.haptic_node.config import HapticConfig

# a take of a fifth of the time
PACE, MASS_KG = 0.15, 0.1
STOP = "foot switch in the supply of the amplifier"


def begins_s(name: str) -> float:
    """Return when a step of a short take begins [s]."""
    steps = steps_of(MASS_KG, PACE)
    names = [step.name for step in steps]
    return sum(step.seconds for step in steps[: names.index(name)])


# the fault that each check has to find; that of `make test` first
SOME: dict[str, dict[str, Any]] = {
    "sign of x": {"signs": (-1.0, 1.0, 1.0)},
}
FURTHER: dict[str, dict[str, Any]] = {
    "cable loss": {"unplug_is_told": False},
    "rendering stiffness": {"extra_delay_s": 0.04},
    "finite positions": {"nan_at_s": begins_s("slow") + 0.5},
    "rate": {"slow": 2.0},
    "jitter": {"every": 20, "stumble": 4},
    "age of samples": {"late_s": 0.02},
    "gaps": {"gap_at_s": begins_s("fast") + 0.3, "gap_s": 0.1},
    "fresh positions": {"hold_s": 0.02},
    "no jumps": {"jump_at_s": begins_s("slow") + 0.5},
    "no frozen readings": {"frozen_at_s": begins_s("hold") + 0.6},
    "noise at rest": {"noise_m": 2e-4},
    "drift at rest": {"drift_m_per_s": 1e-3},
    "resolution": {"step_m": 5e-4},
    "scale of positions": {"scale": 1.5},
    "sign of y": {"axes": (0, 2, 1)},
    "sign of z": {"signs": (1.0, 1.0, -1.0)},
    "sign of forces": {"force_scale": -1.0},
    "scale of forces": {"force_scale": 0.5},
    "limits of force": {"reported_force": 3.0},
    "buttons": {"dead_buttons": 4},
    "dead-man": {"deadman_is_ignored": True},
    "orientation": {"quaternion": (1.0, 1.0, 0.0, 0.0)},
}


def take_of(
    faults: dict[str, Any], mass_kg: float = MASS_KG, stop: str = STOP, pace: float = PACE, **coupling: Any
) -> Take:
    config = HapticConfig.model_validate({"driver": "simulated_impedance", "coupling": coupling})
    return make_take(config, steps_of(mass_kg, pace), Circumstances(mass_kg, stop), lambda step: None, faults)


def found(take: Take) -> dict[str, Verdict]:
    return {verdict.check: verdict for verdict in verdicts_of(take)}


@pytest.fixture(scope="module")
def good() -> Take:
    return take_of({})


def test_motion_takes_a_minute_and_every_check_passes_on_a_good_device(good: Take) -> None:
    assert 55.0 <= sum(step.seconds for step in STEPS) <= 65.0
    verdicts = verdicts_of(good)
    assert [verdict for verdict in verdicts if verdict.result != "pass"] == [] and overall(verdicts) == "pass"
    assert len(verdicts) == len(CHECKS) == 25
    assert set(SOME) | set(FURTHER) | {"workspace", "independent stop"} == {name for name, _, _ in CHECKS}


def finds(name: str, faults: dict[str, Any]) -> None:
    verdicts = found(take_of(faults))
    assert verdicts[name].result == "fail", verdicts[name]
    assert overall(list(verdicts.values())) == "fail"


@pytest.mark.parametrize("name", SOME)
def test_check_finds_the_fault_that_it_is_for(name: str) -> None:
    finds(name, SOME[name])


@pytest.mark.endurance
@pytest.mark.parametrize("name", FURTHER)
def test_each_further_check_finds_the_fault_that_it_is_for(name: str) -> None:
    finds(name, FURTHER[name])


def test_take_is_judged_the_same_from_its_file_and_another_file_is_refused(good: Take, tmp_path: Path) -> None:
    good.save(tmp_path / "take.npz")
    assert verdicts_of(read_take(tmp_path / "take.npz")) == verdicts_of(good)
    np.savez(tmp_path / "other.npz", rows=np.zeros(3), facts="{}")
    for name in ("other.npz", "none.npz"):
        with pytest.raises(ConfigError, match=name):
            read_take(tmp_path / name)


def still(take: Take, name: str) -> Take:
    """Return the take as if the handle had not been moved in a step."""
    rows = take.rows.copy()
    number = [step.name for step in take.steps].index(name)
    chosen = rows["step"] == number
    rows["place_m"][chosen] = rows["place_m"][chosen][0]
    return take._replace(rows=rows)


@pytest.mark.parametrize(
    ("name", "check"), [("fast", "fresh positions"), ("right", "sign of x"), ("slow", "resolution")]
)
def test_motion_that_was_not_made_is_asked_for_once_more(good: Take, name: str, check: str) -> None:
    assert found(still(good, name))[check].result == "retake"


def test_workspace_that_was_not_reached_is_asked_for_and_judges_no_scale(good: Take) -> None:
    rows = good.rows.copy()
    rows["place_m"] *= 0.3
    verdicts = found(good._replace(rows=rows))
    assert (verdicts["workspace"].result, verdicts["scale of positions"].result) == ("retake", "cannot say")


def test_what_a_device_does_not_have_or_nobody_measured_cannot_be_said(good: Take) -> None:
    bare = good._replace(
        device=good.device._replace(buttons=(), deadman="", has_orientation=False),
        steps=tuple(step._replace(name="-") if step.name == MASS_STEP.name else step for step in good.steps),
    )
    verdicts = found(bare)
    for name in ("buttons", "dead-man", "orientation", "scale of forces"):
        assert verdicts[name].result == "cannot say", name


def test_strong_device_without_an_independent_stop_is_refused_and_never_driven_with_its_force(good: Take) -> None:
    without = good._replace(independent_stop="")
    assert found(without)["independent stop"].result == "fail"
    weak = without._replace(settings=good.settings._replace(max_force_n=MOST_WITHOUT_STOP_N))
    assert found(weak)["independent stop"].result == "pass"
    # a hand that is far away makes the coupling pull as hard as it may
    take = take_of({"extra_delay_s": 0.05}, mass_kg=0.0, stop="", pace=0.1)
    assert np.linalg.norm(take.rows["force_n"], axis=1).max() <= MOST_WITHOUT_STOP_N * (1.0 + 1e-9)


def test_unknown_driver_and_faults_are_refused_in_words() -> None:
    steps, said = steps_of(0.0, 0.01), Circumstances()
    with pytest.raises(ConfigError, match="no device that takes a force"):
        make_take(HapticConfig(), steps, said, lambda step: None)
    with pytest.raises(ConfigError, match="simulated_impedance only"):
        make_take(HapticConfig(), steps, said, lambda step: None, {"scale": 2.0})
    config = HapticConfig.model_validate({"driver": "simulated_impedance"})
    for faults, text in (({"size": 2.0}, "no such fault"), ({"scale": "x"}, "a number"), ({"axes": 1}, "a list of 3")):
        with pytest.raises(ConfigError, match=text):
            make_take(config, steps, said, lambda step: None, faults)

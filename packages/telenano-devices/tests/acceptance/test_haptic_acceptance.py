"""The acceptance of a device: a good one passes, and each check finds the fault that it is for."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_devices.acceptance.haptic_device.checks import HAPTIC_DEVICE
from telenano_devices.acceptance.haptic_device.devices import make_take
from telenano_devices.acceptance.haptic_device.take import MASS_STEP, MOST_WITHOUT_STOP_N, STEPS, Facts, steps_of
from telenano_devices.acceptance.take import Take, Verdict, overall, read_take

from telenano.sections import HapticConfig
from telenano.wire import ConfigError

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
    "cable loss": {"unplug_is_reported": False},
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


def take_of(faults: dict[str, Any], mass_kg: float = MASS_KG, stop: str = STOP, pace: float = PACE) -> Take[Facts]:
    config = HapticConfig.model_validate({"driver": "simulated_impedance"})
    return make_take(config, mass_kg, stop, pace=pace, faults=faults)


def found(take: Take[Facts]) -> dict[str, Verdict]:
    return {verdict.check: verdict for verdict in HAPTIC_DEVICE.judge(take)}


def altered(take: Take[Facts], **facts: Any) -> Take[Facts]:
    return take._replace(facts=take.facts._replace(**facts))


@pytest.fixture(scope="module")
def good() -> Take[Facts]:
    return take_of({})


def test_motion_takes_a_minute_and_every_check_passes_on_a_good_device(good: Take[Facts]) -> None:
    assert 55.0 <= sum(step.seconds for step in STEPS) <= 65.0
    verdicts = HAPTIC_DEVICE.judge(good)
    assert [verdict for verdict in verdicts if verdict.result != "pass"] == [] and overall(verdicts) == "pass"
    assert len(verdicts) == 25
    assert set(SOME) | set(FURTHER) | {"workspace", "independent stop"} == {verdict.check for verdict in verdicts}


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


def test_take_is_judged_the_same_from_its_file(good: Take[Facts], tmp_path: Path) -> None:
    good.save(tmp_path / "take.npz")
    kind, take = read_take(tmp_path / "take.npz", HAPTIC_DEVICE)
    assert kind is HAPTIC_DEVICE and take.facts == good.facts and take.steps == good.steps
    assert kind.judge(take) == HAPTIC_DEVICE.judge(good)


def test_a_file_that_is_no_take_or_was_damaged_is_refused_by_its_name(good: Take[Facts], tmp_path: Path) -> None:
    good._replace(rows=good.rows[:50]).save(tmp_path / "take.npz")
    whole = (tmp_path / "take.npz").read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 3] ^= 0xFF
    for name, content in (("cut", whole[:-40]), ("half", whole[: len(whole) // 2]), ("flipped", bytes(flipped)),
                          ("text", b"none"), ("empty", b"")):  # fmt: skip
        (tmp_path / f"{name}.npz").write_bytes(content)
    np.savez(tmp_path / "other.npz", rows=np.zeros(3), facts="{}")
    for name, facts in (("list", "[]"), ("without_steps", "{}"), ("unknown", '{"steps": [], "mass": 1}')):
        np.savez(tmp_path / f"{name}.npz", rows=good.rows[:50], facts=facts)
    np.savez(tmp_path / "no_rows.npz", rows=good.rows[:0], facts="{}")
    for name in (
        "cut", "half", "flipped", "text", "empty", "other", "list", "without_steps", "unknown", "no_rows", "none",
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=f"{name}.npz: is not a take of `telenano device accept`"):
            read_take(tmp_path / f"{name}.npz", HAPTIC_DEVICE)


def still(take: Take[Facts], name: str) -> Take[Facts]:
    """Return the take as if the handle had not been moved in a step."""
    rows = take.rows.copy()
    number = [step.name for step in take.steps].index(name)
    chosen = rows["step"] == number
    rows["place_m"][chosen] = rows["place_m"][chosen][0]
    return take._replace(rows=rows)


@pytest.mark.parametrize(
    ("name", "check"), [("fast", "fresh positions"), ("right", "sign of x"), ("slow", "resolution")]
)
def test_motion_that_was_not_made_is_asked_for_once_more(good: Take[Facts], name: str, check: str) -> None:
    assert found(still(good, name))[check].result == "retake"


def test_workspace_that_was_not_reached_is_asked_for_and_judges_no_scale(good: Take[Facts]) -> None:
    rows = good.rows.copy()
    rows["place_m"] *= 0.3
    verdicts = found(good._replace(rows=rows))
    assert (verdicts["workspace"].result, verdicts["scale of positions"].result) == ("retake", "cannot say")


def test_what_a_device_does_not_have_or_nobody_measured_cannot_be_said(good: Take[Facts]) -> None:
    bare = altered(good, device=good.facts.device._replace(buttons=(), deadman="", has_orientation=False))
    steps = tuple(step._replace(name="-") if step.name == MASS_STEP.name else step for step in good.steps)
    verdicts = found(bare._replace(steps=steps))
    for name in ("buttons", "dead-man", "orientation", "scale of forces"):
        assert verdicts[name].result == "cannot say", name


def test_strong_device_without_an_independent_stop_is_refused_and_driven_with_less_force(
    good: Take[Facts],
) -> None:
    without = altered(good, independent_stop="")
    assert found(without)["independent stop"].result == "fail"
    weak = altered(without, settings=good.facts.settings._replace(max_force_n=MOST_WITHOUT_STOP_N))
    assert found(weak)["independent stop"].result == "pass"
    # a hand that is far away makes the coupling pull as hard as it may
    take = take_of({"extra_delay_s": 0.05}, mass_kg=0.0, stop="", pace=0.1)
    assert np.linalg.norm(take.rows["force_n"], axis=1).max() <= MOST_WITHOUT_STOP_N * (1.0 + 1e-9)


def test_unknown_driver_and_faults_are_refused_in_words() -> None:
    with pytest.raises(ConfigError, match="is not a device that takes a force"):
        make_take(HapticConfig(), pace=0.01)
    with pytest.raises(ConfigError, match="simulated_impedance only"):
        make_take(HapticConfig(), pace=0.01, faults={"scale": 2.0})
    config = HapticConfig.model_validate({"driver": "simulated_impedance"})
    for faults, text in (({"size": 2.0}, "no such fault"), ({"scale": "x"}, "a number"), ({"axes": 1}, "a list of 3")):
        with pytest.raises(ConfigError, match=text):
            make_take(config, pace=0.01, faults=faults)

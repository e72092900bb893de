"""Configuration: presets, overrides, errors that name the key, and the block of the README."""

import json
import math
import re
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError
from telenano_lab.studies.pages.motor_theory import bandwidth_hz

import services.haptic_node
from telenano.extend.hands import DriveCommand
from telenano.hand.operator import FORCE_PROFILE, IMPEDANCE
from telenano.hand.sim import SimulatedHaptic
from telenano.sections.hand_section import SERVO_GAINS_V_PER_M, DeviceConfig, HapticConfig, LimitsConfig, recorded_hand
from telenano.sections.operator_section import ImpedanceConfig

README = Path(services.haptic_node.__file__).with_name("README.md")


def load(document) -> HapticConfig:
    """As the loader of the nodes does it: through JSON."""
    return HapticConfig.model_validate_json(json.dumps(document))


def faults(document) -> str:
    with pytest.raises(ValidationError) as caught:
        load(document)
    return "\n".join(
        f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in caught.value.errors(include_url=False)
    )


def test_defaults_are_table_1_and_fig_12():
    params = load({}).to_params()
    arm = params.plant.motor
    assert (arm.speed_gain_rad_per_s_v, arm.screw_m_per_rad, arm.time_constant_s) == (29.41, 2.79e-5, 1.1e-3)
    assert arm.friction_torque_n_m == 3.15e-3
    assert arm.position_max_m - arm.position_min_m == 0.020
    assert params.safety.command_deadline_s == 0.050
    assert params.plant.operator.times_s.tolist() == [0.8, 1.2, 2.6, 2.9, 4.5, 4.6]
    assert params.plant.operator.values.tolist() == [0.0, 1.0, 1.0, 2.0, 2.0, 0.0]


def test_preset_sets_the_gain_and_an_override_wins():
    for preset, gain in SERVO_GAINS_V_PER_M.items():
        assert load({"device": {"preset": preset}}).to_params().plant.motor.servo_gain_v_per_m == gain
    own = load({"device": {"preset": "paper_gain", "servo_gain_v_per_m": 5e4, "armature_resistance_ohm": 2.0}})
    arm = own.to_params().plant.motor
    assert (arm.servo_gain_v_per_m, arm.armature_resistance_ohm) == (5e4, 2.0)


def test_described_bands_of_friction_are_the_computed_ones():
    """The numbers in the description of the resistance are not to drift from the defaults."""
    text = DeviceConfig.model_fields["armature_resistance_ohm"].description or ""
    arm = DeviceConfig().to_params()
    volts = arm.friction_torque_n_m * arm.armature_resistance_ohm * arm.speed_gain_rad_per_s_v
    assert f"{volts:.3f} V" in text
    assert f"{volts / SERVO_GAINS_V_PER_M['paper_bandwidth'] * 1e6:.1f} um" in text
    assert f"{volts / SERVO_GAINS_V_PER_M['paper_gain'] * 1e6:.0f} um" in text
    unloaded = arm.voltage_limit_v * arm.speed_gain_rad_per_s_v * arm.screw_m_per_rad
    assert f"{unloaded * 1e3:.0f} mm/s" in (DeviceConfig.model_fields["voltage_limit_v"].description or "")


def test_operator_is_chosen_by_kind():
    assert load({"operator": {"kind": "force_profile"}}).to_params().plant.operator.kind == FORCE_PROFILE
    hand = {"kind": "impedance", "path": [{"time_s": 0, "position_m": 0}], "stiffness_n_per_m": 0}
    params = load({"operator": hand}).to_params().plant.operator
    assert (params.kind, params.stiffness_n_per_m, params.times_s.dtype.kind) == (IMPEDANCE, 0.0, "f")


def profile(**keys):
    return {"operator": {"kind": "force_profile", **keys}}


def hand_path(*times):
    return {"operator": {"kind": "impedance", "path": [{"time_s": t, "position_m": 0.0} for t in times]}}


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"devise": {}}, "devise: Extra inputs are not permitted"),
        ({"device": {"preset": "fast"}}, "device.preset: Input should be 'paper_bandwidth' or 'paper_gain'"),
        (
            {"device": {"servo_gain_v_per_m": 0.0}},
            "device.servo_gain_v_per_m: Input should be greater than or equal to 0.001",
        ),
        ({"device": {"servo_gain_v_per_m": "1e4"}}, "device.servo_gain_v_per_m: Input should be a valid number"),
        ({"device": {"time_constant_s": math.nan}}, "device.time_constant_s: Input should be a finite number"),
        ({"device": {"friction_torque_n_m": -1e-3}}, "device.friction_torque_n_m: Input should be greater than or"),
        ({"device": {"torque_limit_n_m": 3.15e-3}}, "device: Value error, torque_limit_n_m = 0.00315 N m must exceed"),
        ({"device": {"position_min_m": 0.02}}, "device: Value error, position_min_m = 0.02 m must be below"),
        ({"device": {"start_position_m": 0.1}}, "device: Value error, start_position_m = 0.1 m must lie between"),
        (
            {"device": {"servo_gain_v_per_m": 1e7, "speed_gain_rad_per_s_v": 100.0}},
            "device: Value error, servo_gain_v_per_m = 10000000.0 V/m with this motor rings at",
        ),
        (
            {"limits": {"command_deadline_s": 0}},
            "limits.command_deadline_s: Input should be greater than or equal to 0.000001",
        ),
        ({"limits": {"position_max_m": -0.0045}}, "limits: Value error, position_min_m = -0.0045 m must be below"),
        ({"limits": {"position_max_m": 0.016}}, "limits.position_max_m = 0.016 m must lie between the end stops"),
        ({"limits": {"max_speed_m_per_s": 0.05}}, "limits.max_speed_m_per_s = 0.05 m/s is more than the device can do"),
        ({"operator": {"kind": "robot"}}, "operator: Input tag 'robot' found using 'kind' does not match"),
        ({"operator": {"kind": "impedance"}}, "operator.impedance.path: Field required"),
        (profile(points=[]), "operator.force_profile.points: Tuple should have at least"),
        (profile(max_force_n=0), "operator.force_profile.max_force_n: Input should be"),
        (
            profile(points=[{"time_s": 0.0, "force_n": math.inf}]),
            "operator.force_profile.points.0.force_n: Input should be a finite number",
        ),
        (
            profile(points=[{"time_s": 1.0, "force_n": 0}, {"time_s": 1.0, "force_n": 1}]),
            "points: Value error, time_s = 1.0 s of corner 1 must be later than 1.0 s",
        ),
        (hand_path(0.0, 2.0, 1.0), "path: Value error, time_s = 1.0 s of corner 2 must be later than 2.0 s"),
    ],
)
def test_error_names_the_key_and_what_is_right(document, expected):
    assert expected in faults(document)


def test_every_field_is_described_with_a_unit_in_its_name():
    for model in (HapticConfig, *(type(getattr(HapticConfig(), name)) for name in ("device", "limits", "operator"))):
        for name, field in model.model_fields.items():
            assert field.description, f"{model.__name__}.{name}"
            if field.annotation in (float, float | None):
                assert re.search(r"_(m|s|n|v|ohm|kg|v_per_m|rad_per_s_v|m_per_rad|n_m|m_per_s)$", name), name


def test_readme_blocks_are_valid_sections_and_the_hand_names_every_key():
    blocks = re.findall(r"```yaml\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    sections = [yaml.safe_load(block)["haptic_node"] for block in blocks]
    assert len([load(section) for section in sections]) == 2
    assert set(sections[0]["operator"]) == set(ImpedanceConfig.model_fields)


def test_bandwidths_in_the_readme_are_the_computed_ones():
    text = README.read_text(encoding="utf-8")
    for preset in SERVO_GAINS_V_PER_M:
        assert f"{bandwidth_hz(DeviceConfig(preset=preset).to_params()):.3f} Hz" in text


def test_named_arm_gives_what_is_not_given():
    hand = {"kind": "impedance", "path": [{"time_s": 0, "position_m": 0}], "arm": "stiff", "mass_kg": 0.5}
    params = load({"operator": hand}).to_params().plant.operator
    assert (params.stiffness_n_per_m, params.damping_n_s_per_m, params.mass_kg) == (1000.0, 20.0, 0.5)


def _ends() -> list[tuple[str, str, float]]:
    found = []
    for section, model in (("device", DeviceConfig), ("limits", LimitsConfig), ("operator", ImpedanceConfig)):
        for key, schema in model.model_json_schema()["properties"].items():
            kind = schema.get("anyOf", [schema])[0]
            if kind.get("type") == "number":
                found += [(section, key, kind[end]) for end in ("minimum", "maximum")]
    return found


@pytest.mark.parametrize(("section", "key", "value"), _ends())
def test_the_device_gives_numbers_at_every_end_of_its_settings(section, key, value):
    path = [{"time_s": 0.0, "position_m": -1.0}, {"time_s": 1e-9, "position_m": 1.0}]
    document = {"operator": {"kind": "impedance", "path": path}}
    document[section] = {**document.get(section, {}), key: value}
    try:
        config = load(document)
    except ValidationError as error:
        # what contradicts another key is refused in words
        assert "Value error" in str(error)
        return
    device = SimulatedHaptic(config.to_plant_params(), config.device.start_position_m)
    assert all(math.isfinite(part) for part in device.capabilities if isinstance(part, float))
    device.open()
    for tick in range(10):
        device.write(
            DriveCommand(tick % 2, (config.limits.position_min_m, config.limits.position_max_m)[tick // 5], 0.0)
        )
        reading = device.read(tick * 1e-3, 1e-3)
        assert all(math.isfinite(part) for part in reading[:9]), (section, key, value, reading)


def test_the_hand_of_a_recording_is_read_without_the_package_that_has_its_driver():
    hand = {"kind": "force_profile", "points": [{"time_s": 0.5, "force_n": 1.0}]}
    section = {"driver": "of_nobody_here", "of_nobody_here": {"port": 1}, "limits": {"no": "key"}, "operator": hand}
    operator, simulated = recorded_hand(section, "scenario.yaml")
    assert operator.points[0].force_n == 1.0
    assert not simulated
    assert recorded_hand({}, "scenario.yaml") == (HapticConfig().operator, True)
    moved = {"driver": "simulated_impedance", "coupling": {"rest_s": 0.05}, "operator": hand}
    assert recorded_hand(moved, "scenario.yaml")[1]

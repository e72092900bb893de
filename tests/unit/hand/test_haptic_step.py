"""The whole chain, compiled and plain, and the simulated driver against it."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from telenano.extend.hands import MODE_FORCE, MODE_OFF, MODE_POSITION, DeviceError, DriveCommand, HapticDevice
from telenano.hand import safety, sim, step
from telenano.hand.sim import SimulatedHaptic
from telenano.hand.step import HapticInputs
from telenano.sections.hand_section import HapticConfig

DT = 1e-3
CONFIGS = {
    "force_profile": HapticConfig(),
    "impedance": HapticConfig.model_validate_json(
        '{"operator": {"kind": "impedance",'
        ' "path": [{"time_s": 0.1, "position_m": 0.0}, {"time_s": 0.6, "position_m": 0.01}]}}'
    ),
}


def command(index: int) -> HapticInputs:
    """A session with everything in it: motion, a lost link, an e-stop, a refused mode, a reference out of travel."""
    reference = 0.02 * math.sin(2.0 * math.pi * 0.7 * index * DT)
    age = 0.2 if 300 <= index < 360 else 0.001
    mode = MODE_FORCE if 500 <= index < 520 else MODE_POSITION
    return HapticInputs(mode, reference, 0.0, age, (index - 50) * DT, index == 700, index == 800)


def trace(config: HapticConfig, count: int) -> np.ndarray:
    params, state = config.to_params(), config.initial_state()
    rows = []
    for index in range(count):
        state, out = step.step(params, state, command(index), DT)
        rows.append([*map(float, out.applied), *map(float, out.reading[:9])])
    return np.array(rows)


def test_chain_shows_every_answer_of_the_session():
    rows = trace(CONFIGS["force_profile"], 1500)
    mode, reason = rows[:, 0].astype(int), rows[:, 3].astype(int)
    assert set(reason) == {
        safety.REASON_NONE,
        safety.REASON_COMMAND_STALE,
        safety.REASON_MODE_REFUSED,
        safety.REASON_ESTOP,
        safety.REASON_SPEED_LIMIT,
        safety.REASON_TRAVEL_LIMIT,
    }
    assert np.all(mode[300:360] == MODE_OFF) and mode[360] == MODE_POSITION
    assert np.all(mode[700:800] == MODE_OFF) and mode[800] == MODE_POSITION
    position, voltage, force = rows[:, 6], rows[:, 11], rows[:, 10]
    # Off: no voltage, and a few milliseconds later a screw that stands and carries nothing.
    for off in (slice(320, 360), slice(720, 800)):
        assert np.all(voltage[off] == 0.0) and np.all(force[off] == 0.0)
        assert np.ptp(position[off]) == 0.0
    speed_limit = CONFIGS["force_profile"].limits.max_speed_m_per_s
    assert np.max(np.abs(np.diff(position))) <= 1.01 * speed_limit * DT


@pytest.mark.parametrize("kind", CONFIGS)
def test_the_driver_behind_the_guard_is_the_compiled_chain(kind):
    """What a node does with guard and driver gives, bit for bit, what a study gets from the one step."""
    config = CONFIGS[kind]
    params = config.to_params()
    device: HapticDevice = SimulatedHaptic(config.to_plant_params(), config.device.start_position_m)
    guard, position = config.initial_state().safety, config.device.start_position_m
    expected = trace(config, 900)
    device.open()
    for index in range(900):
        given = command(index)
        inputs = safety.SafetyInputs(*given[:4], given.estop, given.arm_requested, position)
        guard, applied = safety.step(params.safety, guard, inputs, DT)
        device.write(DriveCommand(applied.mode, applied.position_reference_m, applied.force_reference_n))
        reading = device.read(given.session_time_s, DT)
        position = reading.position_m
        assert [*map(float, applied), *map(float, reading[:9])] == list(expected[index])
    device.close()


@pytest.mark.check("takes 1.1 s")
def test_plain_python_gives_the_same_numbers():
    """In a process of its own, since the compiler is switched off for a whole process."""
    here = Path(__file__)
    code = (
        f"import sys; sys.path.insert(0, {str(here.parent)!r}); import test_haptic_step as t;"
        "print(*(x.hex() for k in t.CONFIGS for x in t.trace(t.CONFIGS[k], 600).ravel().tolist()))"
    )
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    root = here.parents[3]
    done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    plain = np.array([float.fromhex(word) for word in done.stdout.split()])
    compiled = np.concatenate([trace(config, 600).ravel() for config in CONFIGS.values()])
    np.testing.assert_allclose(plain, compiled, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("dt", [0.0, -1e-3, math.nan])
def test_period_that_is_no_time_is_refused(dt):
    config = CONFIGS["force_profile"]
    with pytest.raises(ValueError, match="positive time in s"):
        step.step(config.to_params(), config.initial_state(), command(0), dt)
    device = SimulatedHaptic(config.to_plant_params(), 0.0)
    device.open()
    with pytest.raises(ValueError, match="dt_s"):
        device.read(0.0, dt)


def test_simulated_driver_must_be_open_and_refuses_force_mode():
    device = SimulatedHaptic(CONFIGS["force_profile"].to_plant_params(), 0.0)
    hold = DriveCommand(MODE_POSITION, 0.0, 0.0)
    for call in (lambda: device.read(0.0, DT), lambda: device.write(hold)):
        with pytest.raises(DeviceError, match="not open"):
            call()
    device.make_safe()
    device.open()
    with pytest.raises(DeviceError, match=r"mode 2 \(force\).*0 \(off\), 1 \(position\)"):
        device.write(DriveCommand(MODE_FORCE, 0.0, 1.0))
    with pytest.raises(DeviceError, match=r"mode 7 \(unknown\)"):
        device.write(DriveCommand(7, 0.0, 1.0))
    device.close()
    device.close()
    with pytest.raises(DeviceError, match="not open"):
        device.write(hold)


def test_make_safe_stops_a_moving_arm():
    device = SimulatedHaptic(CONFIGS["force_profile"].to_plant_params(), 0.0)
    device.open()
    for _ in range(20):
        device.write(DriveCommand(MODE_POSITION, 0.01, 0.0))
        moving = device.read(-1.0, DT)
    assert moving.velocity_m_per_s > 0.01
    device.make_safe()
    readings = [device.read(-1.0, DT) for _ in range(20)]
    assert readings[-1].velocity_m_per_s == 0.0 and readings[-1].position_m == readings[-2].position_m
    assert all(reading.motor_voltage_v == 0.0 for reading in readings)
    assert readings[-1].motor_force_n == readings[-1].motor_voltage_v == 0.0


def test_declared_capabilities_follow_the_constants():
    params = CONFIGS["force_profile"].to_plant_params()
    declared = sim.capabilities(params)
    torque_constant = 1.0 / params.motor.speed_gain_rad_per_s_v
    damping = torque_constant**2 / params.motor.armature_resistance_ohm / params.motor.screw_m_per_rad**2
    assert declared.max_damping_n_s_per_m == pytest.approx(damping, rel=1e-12, abs=0.0)
    assert declared.max_stiffness_n_per_m == pytest.approx(2.0 * damping / 1e-3, rel=1e-12, abs=0.0)
    assert declared.max_force_n == 10.0
    assert declared.workspace_max_m - declared.workspace_min_m == 0.020
    assert declared.modes == (MODE_OFF, MODE_POSITION)
    weak = params._replace(motor=params.motor._replace(torque_limit_n_m=3.15e-3 + 2.79e-5))
    assert sim.capabilities(weak).max_force_n == pytest.approx(1.0, rel=1e-9, abs=0.0)

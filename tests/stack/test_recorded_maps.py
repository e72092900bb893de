"""A recorded map, and a channel that is no force, felt in a bilateral session of a live rig."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recording.reader import Recording


def messages(rig: Any, topic: str) -> list[Any]:
    return [found.decode() for found in Recording(rig.out / "session.mcap").messages((topic,))]


def grid(path: Path, **members: Any) -> list[str]:
    """Write a map of one curve; return the options that put it under the tip."""
    np.savez(path, x=np.zeros(1), y=np.zeros(1), length_unit="m", source="made", **members)
    return ["--set", f"afm_node.sample.map={path}"]


@pytest.mark.endurance
@pytest.mark.stack
def test_a_live_session_feels_the_curves_of_a_recorded_map(rig: Any, tmp_path: Path) -> None:
    z = np.linspace(-5e-9, 40e-9, 451)
    down = np.where(z > 0.5e-9, 0.0, -1.0 * z)
    up = np.where(z > 6e-9, 0.0, np.maximum(-1.0 * z, -4e-9))
    value = np.stack([down, up], axis=1)[None, None]
    force = {"unit": "N", "sign": 1, "axis": "base", "stiffness_n_per_m": 2.0}
    rig.run(*grid(tmp_path / "map.npz", value=value, z=z, **force))
    states = messages(rig, "afm/state")
    height = 10e-9 + np.array([state.base_position_m[2] for state in states])
    felt = np.array([state.tip_force_n[2] for state in states])
    error = np.min([np.abs(felt - np.interp(height, z, branch)) for branch in (down, up)], axis=0)
    jumps = np.min([np.abs(height - edge) for edge in (0.5e-9, 4e-9, 6e-9)], axis=0) < 0.3e-9
    assert error[~jumps].max() < 1e-14
    # the hand of Fig. 12 is drawn in, and presses to the end of the map
    assert felt.max() > 2e-9
    assert felt.min() < -1e-10
    assert any("the recorded map ends here" in event.text for event in messages(rig, "session/event"))
    assert max(abs(command.force_n[2]) for command in messages(rig, "haptic/command")) > 0.2


@pytest.mark.endurance
@pytest.mark.stack
def test_a_live_session_feels_a_frequency_shift_until_it_leaves_the_branch(rig: Any, tmp_path: Path) -> None:
    z = np.linspace(0.0, 12e-9, 601)
    # the minimum of -30 Hz is 2 nm above the bottom
    shift = -30.0 * (z / 2e-9) * np.exp(1.0 - z / 2e-9)
    options = grid(tmp_path / "shift.npz", value=shift[None, None], z=z, unit="Hz")
    feel = {
        "channel": "frequency_shift", "unit": "Hz", "table": [[-2.0, 0.0], [-28.0, 3e-9]], "tolerance": 0.1,
        "slope_limit_n_per_unit": 1e-9,
    }  # fmt: skip
    rig.run(*options, "--set", f"afm_node.feel={json.dumps(feel)}")
    states = [state for state in messages(rig, "afm/state") if state.felt_value is not None]
    assert {state.felt_channel for state in states} == {"frequency_shift"}
    height = 10e-9 + np.array([state.base_position_m[2] for state in states])
    assert np.abs([state.felt_value for state in states] - np.interp(height, z, shift)).max() < 0.05
    on_branch = [state for state in states if state.felt_clamp == "" and state.mode == "follow"]
    assert len(on_branch) > 100
    for state in on_branch:
        assert state.tip_force_n[2] == pytest.approx((-state.felt_value - 2.0) / 26.0 * 3e-9, rel=1e-6, abs=1e-15)
    texts = [event.text for event in messages(rig, "session/event")]
    assert any("frequency_shift" in text and "has left the branch of feel.table" in text for text in texts)
    assert states[-1].mode == "retracted"

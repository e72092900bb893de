"""A recorded map without forces is felt by a table: what is shown, what leaves its branch, what the guard judges."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_maps import Rig, config_of, frequency_shift_hz, write_npz

from telenano.sections import AfmConfig

# the frequency shift of `recorded_maps` falls to its minimum of -8 Hz at 0.4 nm
FEEL = {
    "channel": "frequency_shift", "unit": "Hz", "table": [[-0.5, 0.0], [-4.0, 1e-9], [-7.5, 3e-9]], "tolerance": 0.05,
    "slope_limit_n_per_unit": 1e-9, "rate_limit_n_per_s": 1e-3,
}  # fmt: skip


@pytest.fixture
def grid(tmp_path: Path) -> Path:
    """Write a map of a frequency shift, there and back, whose four columns differ by 1 % from one to the next."""
    z = np.linspace(0.0, 2e-9, 201)
    shift = frequency_shift_hz(z) * (1.0 + 0.01 * np.arange(4))[:, None, None]
    both = np.broadcast_to(np.stack([shift, 0.9 * shift], axis=3), (4, 3, 201, 2))
    x, y = (1e-9 * (np.arange(count) - 0.5 * (count - 1)) for count in (4, 3))
    return write_npz(tmp_path / "map.npz", {"value": both, "x": x, "y": y, "z": z, "unit": "Hz", "length_unit": "m"})


def test_a_recorded_frequency_shift_is_felt_and_shown_as_no_force(bench_of: Any, grid: Path) -> None:
    rig = Rig(bench_of("afm_node@slave"), config_of(grid, rest_distance_m=2e-9, feel=FEEL))
    rig.go(0.0)
    rig.control("arm", place="hand")
    for z_m in np.linspace(1.9e-9, 0.7e-9, 20).tolist():
        # the middle of four columns, whose shifts differ by 1 %
        state = rig.go(2e-9 - z_m, 5)
        expected = 1.015 * float(frequency_shift_hz(z_m))
        assert state.felt_channel == "frequency_shift"
        assert state.felt_value == pytest.approx(expected, rel=2e-3)
        assert state.tip_force_n[2] == pytest.approx(
            np.interp(-expected, [0.5, 4.0, 7.5], [0.0, 1e-9, 3e-9]), rel=1e-2, abs=1e-12
        )
        assert (state.deflection_m, state.mode) == (0.0, "follow")


def test_leaving_the_branch_retracts_and_arming_begins_anew(bench_of: Any, grid: Path) -> None:
    rig = Rig(bench_of("afm_node@slave"), config_of(grid, rest_distance_m=2e-9, feel=FEEL))
    rig.go(0.0)
    rig.control("arm", place="hand")
    for z_m in np.linspace(1.9e-9, 0.3e-9, 80).tolist():
        rig.go(2e-9 - z_m, 3)
    state = rig.go(1.7e-9, 3)
    assert state.mode in ("retracting", "retracted")
    said = rig.said()
    assert sum("has left the branch of feel.table: the tip retracts" in text for text in said) == 1
    assert any("force_invalid" in text for text in said)
    rig.go(0.0, 20)
    rig.control("arm", place="hand")
    assert rig.go(0.5e-9, 20).mode == "follow"


def test_the_guard_judges_what_is_felt(bench_of: Any, grid: Path) -> None:
    changes = {"safety": {"force_limit_n": 1.5e-9}, "feel": FEEL, "rest_distance_m": 2e-9}
    rig = Rig(bench_of("afm_node@slave"), config_of(grid, **changes))
    rig.go(0.0)
    rig.control("arm", place="hand")
    for z_m in np.linspace(1.9e-9, 0.75e-9, 40).tolist():
        rig.go(2e-9 - z_m, 3)
    assert any("force_limit" in text for text in rig.said())


def test_a_map_of_another_channel_needs_a_table(grid: Path) -> None:
    with pytest.raises(ValueError, match=r"has frequency_shift and no forces: feel\.channel must be frequency_shift"):
        config_of(grid, rest_distance_m=2e-9)


def test_an_instrument_without_the_channel_retracts_as_soon_as_it_is_armed(bench_of: Any) -> None:
    rig = Rig(bench_of("afm_node@slave"), AfmConfig.model_validate({"feel": FEEL}))
    rig.go(0.0)
    rig.control("arm", place="hand")
    assert rig.go(0.0, 3).mode in ("retracting", "retracted")
    assert any("frequency_shift = nan has left the branch" in text for text in rig.said())

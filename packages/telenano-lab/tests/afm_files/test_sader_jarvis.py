"""The force of a recorded frequency shift, against forces in closed form whose shift is integrated numerically."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.afm_files.force_map import MapError, checked_map, read_map
from telenano_lab.afm_files.sader_jarvis import as_force

from telenano.testing import invoke

STIFFNESS_N_PER_M, RESONANCE_HZ = 1800.0, 25e3
Z = np.linspace(0.0, 6e-9, 601)
Force = Callable[[Any], Any]


def morse(z: Any) -> Any:
    """Return the force of a Morse potential, repulsive below 0.35 nm, with 0.35 nN of attraction [N]."""
    bond_j, kappa, rest_m = 1.2e-19, 1.2e10, 0.35e-9
    stretch = np.exp(-kappa * (np.asarray(z) - rest_m))
    return 2.0 * bond_j * kappa * (stretch**2 - stretch)


def lennard_jones(z: Any) -> Any:
    """Return the force of a 12-6 potential with its well of 0.1 aJ at 0.4 nm, beginning 0.3 nm from the atom [N]."""
    share = 0.4e-9 / (np.asarray(z) + 0.3e-9)
    return 12.0 * 1e-19 / 0.4e-9 * (share**13 - share**7)


def shift_hz(force: Force, z: Any, amplitude_m: float) -> Any:
    """Return the shift of a harmonic oscillation whose closest approach is at z, by Gauss and Chebyshev [Hz]."""
    nodes = np.cos((np.arange(400) + 0.5) * math.pi / 400)
    forces = force(np.asarray(z)[:, None] + amplitude_m * (1.0 + nodes))
    return -RESONANCE_HZ / (amplitude_m * STIFFNESS_N_PER_M) * np.mean(forces * nodes, axis=1)


def map_of(shift: Any, **changes: Any) -> Any:
    place = {"x": np.zeros(1), "y": np.zeros(1), "z": Z, "length_unit": "m"}
    return checked_map({**place, "unit": "Hz", **changes}, np.asarray(shift)[None, None])


def sensor(amplitude_m: float) -> dict[str, Any]:
    return {"stiffness_n_per_m": STIFFNESS_N_PER_M, "resonance_hz": RESONANCE_HZ, "amplitude_m": amplitude_m}


@pytest.mark.parametrize("amplitude_m", [5e-12, 50e-12, 200e-12, 2e-9])
@pytest.mark.parametrize("force", [morse, lennard_jones])
def test_the_force_is_that_of_the_closed_form_at_any_amplitude(force: Force, amplitude_m: float) -> None:
    found = as_force(map_of(shift_hz(force, Z, amplitude_m)), sensor(amplitude_m))
    assert (found.quantity, found.stiffness_n_per_m) == ("force", STIFFNESS_N_PER_M)
    expected = force(Z)
    deepest = float(expected.min())
    # from the greatest attraction outwards the inversion is within some 7 % of the greatest attraction
    kept = (Z[np.argmin(expected)] <= Z) & (Z < 3e-9)
    assert np.abs(found.values[0, 0, 0] - expected)[kept].max() < 0.08 * abs(deepest)
    # on the repulsive flank, up to a repulsion as great, within 18 %
    flank = (Z[np.argmin(expected)] > Z) & (expected <= abs(deepest))
    assert np.abs(found.values[0, 0, 0] - expected)[flank].max() < 0.19 * abs(deepest)
    assert found.values.min() == pytest.approx(deepest, rel=0.08)
    assert Z[np.argmin(found.values[0, 0, 0])] == pytest.approx(Z[np.argmin(expected)], abs=1.1e-11)


def test_an_offset_of_the_shift_is_taken_off_and_both_branches_are_converted() -> None:
    shift = shift_hz(morse, Z, 50e-12)
    plain = as_force(map_of(shift), sensor(50e-12))
    both = map_of(np.stack([shift + 3.0, 2.0 * shift - 1.0], axis=1))
    found = as_force(both, sensor(50e-12))
    assert found.values[0, 0, 0] == pytest.approx(plain.values[0, 0, 0], rel=1e-9, abs=1e-18)
    assert found.values[1, 0, 0] == pytest.approx(2.0 * plain.values[0, 0, 0], rel=1e-9, abs=1e-18)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"amplitude_m": None}, "amplitude_m: is missing; --as force needs it"),
        ({"resonance_hz": 0.0}, "resonance_hz: is 0.0; --as force needs it as a number above 0"),
        ({"stiffness_n_per_m": "stiff"}, "stiffness_n_per_m: is 'stiff'"),
    ],
)
def test_what_is_missing_is_asked_for(change: dict[str, Any], words: str) -> None:
    with pytest.raises(MapError, match=words):
        as_force(map_of(shift_hz(morse, Z, 50e-12)), {**sensor(50e-12), **change})


def test_a_curve_that_ends_too_near_and_another_quantity_are_refused() -> None:
    near = shift_hz(morse, 0.3e-9 + 0.033 * Z, 50e-12)
    with pytest.raises(MapError, match=r"still changes by \d+ % of its greatest attraction in the farthest tenth"):
        as_force(map_of(near), sensor(50e-12))
    with pytest.raises(MapError, match="--as force: is for a frequency shift; this is a map of current"):
        as_force(map_of(near, unit="nA"), sensor(50e-12))


def test_the_command_writes_a_map_that_is_felt_as_a_force(tmp_path: Path) -> None:
    place = {"x": np.zeros(1), "y": np.zeros(1), "z": Z, "length_unit": "m"}
    np.savez(tmp_path / "shift.npz", value=shift_hz(morse, Z, 50e-12)[None, None], unit="Hz", **place)
    words = [word for key, value in sensor(50e-12).items() for word in ("--set", f"{key}={value}")]
    out = tmp_path / "force.npz"
    arguments = ["sample", "import", str(tmp_path / "shift.npz"), "--out", str(out), "--as", "force", *words]
    result = invoke(arguments)
    assert result.exit_code == 0, result.output
    assert "the force is computed from the frequency shift" in " ".join(result.output.split())
    found, _ = read_map(out)
    assert (found.quantity, found.stiffness_n_per_m) == ("force", STIFFNESS_N_PER_M)
    assert found.values.min() == pytest.approx(morse(Z).min(), rel=0.08)
    refused = invoke(["sample", "info", str(out), "--set", "amplitude_m=1e-10"])
    assert refused.exit_code == 2
    assert "amplitude_m: is not a member of a map" in refused.output

"""A recorded map is felt as it was measured: interpolation, both branches, the edges, and files that cannot be used."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_maps import Rig, config_of, force_n, forces, hysteretic, members, near, write_npz
from telenano_lab.afm_files import recorded_map
from telenano_lab.afm_files.force_map import checked_map, gates, map_params, read_map, write_map
from telenano_lab.afm_files.recorded_map import MapState, value_at
from telenano_lab.doubles.maker_files import adhesive

from telenano.extend.samples import PlantInputs
from telenano.numerics import compiled_form
from telenano.wire import ConfigError, RefusedError


def params_of(made: dict[str, Any], rest_m: float = 20e-9) -> recorded_map.MapParams:
    made = dict(made)
    return map_params(checked_map(made, made.pop("value")), rest_m, 40.0, 1.0)


def test_between_its_points_a_map_is_the_tensor_of_scipys_cubics_of_hermite() -> None:
    scipy = pytest.importorskip("scipy.interpolate")
    values = np.random.default_rng(1).normal(size=(1, 6, 5, 9))

    def along(grid: Any, axis: int, place: float) -> Any:
        count = grid.shape[axis]
        slopes = np.gradient(grid, axis=axis, edge_order=2)
        return scipy.CubicHermiteSpline(np.arange(count), grid, slopes, axis=axis)(place)

    places = np.random.default_rng(2).uniform(0.0, 1.0, (200, 3)) * [5.0, 4.0, 8.0]
    for place in places.tolist():
        expected = along(along(along(values[0], 2, place[2]), 1, place[1]), 0, place[0])
        assert value_at(values, 0, tuple(place)) == pytest.approx(float(expected), rel=1e-12, abs=1e-13)


def test_a_map_goes_through_its_points_and_its_slope_has_no_jump() -> None:
    values = np.random.default_rng(3).normal(size=(2, 4, 3, 7))
    for index in np.ndindex(4, 3, 7):
        assert value_at(values, 1, tuple(map(float, index))) == values[(1, *index)]
    step = 1e-6
    for k in range(1, 6):
        before, at, after = (value_at(values, 0, (1.3, 0.7, k + d * step)) for d in (-1.0, 0.0, 1.0))
        assert (after - at) / step == pytest.approx((at - before) / step, abs=1e-4)


@pytest.mark.parametrize("shape", [(1, 1, 9), (2, 1, 9), (3, 2, 9)])
def test_a_short_axis_is_constant_or_linear(shape: tuple[int, int, int]) -> None:
    x, y, z = np.indices(shape, dtype=np.float64)
    values = (0.5 + (2.0 * x if shape[0] > 1 else 0.0) - (3.0 * y if shape[1] > 1 else 0.0) + 0.25 * z)[None]
    place = (0.3 if shape[0] > 1 else 0.0, 0.6 if shape[1] > 1 else 0.0, 4.4)
    assert value_at(values, 0, place) == pytest.approx(0.5 + 2.0 * place[0] - 3.0 * place[1] + 1.1, rel=1e-12)


def test_compiled_and_plain_give_the_same_bits() -> None:
    pytest.importorskip("numba")
    params = params_of(hysteretic())
    fast, drawn = compiled_form(recorded_map.step), np.random.default_rng(4)
    heights = np.clip(10e-9 + np.cumsum(drawn.normal(0.0, 1e-9, 400)), 0.0, 20e-9)
    plain_state = fast_state = MapState(30e-9, 0.0, False, 0.0)
    for z_m in heights.tolist():
        inputs = PlantInputs(params.rest_distance_m - z_m, 0.0, 0.0)
        plain_state, plain = recorded_map.step(params, plain_state, inputs, 1e-3)
        fast_state, quick = fast(params, fast_state, inputs, 1e-3)
        assert tuple(plain) == tuple(quick)
        assert tuple(plain_state) == tuple(fast_state)


def test_a_place_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="must be finite"):
        value_at(np.zeros((1, 4, 4, 4)), 0, (math.nan, 0.0, 0.0))


def test_a_smooth_map_is_felt_within_its_error_of_interpolation() -> None:
    params = params_of(members())
    for x_m, y_m in ((0.0, 0.0), (31e-9, -22e-9), (-50e-9, 30e-9)):
        heights = np.linspace(20e-9, 0.0, 137)
        felt = np.array(forces(params, heights, x_m, y_m))
        # 25 nm a pixel along x, where the range of the force is a wave of 314 nm
        assert np.abs(felt - force_n(heights, x_m, y_m)).max() < 0.02 * 4e-9


def test_a_whole_loop_follows_both_curves_of_the_file() -> None:
    params, heights = params_of(hysteretic()), np.linspace(20e-9, 0.0, 201)
    down, up = adhesive(heights)
    felt = forces(params, [*heights, *heights[::-1]])
    assert np.abs(np.array(felt[:201]) - down).max() < 1e-15
    assert np.abs(np.array(felt[201:]) - up[::-1]).max() < 1e-15


def test_a_tip_that_has_not_touched_goes_back_as_it_came() -> None:
    heights = np.linspace(20e-9, 5e-9, 151)
    assert max(map(abs, forces(params_of(hysteretic()), [*heights, *heights[::-1]]))) < 1e-15


def test_an_attached_tip_stays_so_in_both_senses_until_the_loop_is_closed() -> None:
    params = params_of(hysteretic())
    way = [20e-9, 10e-9, 4.5e-9, 2e-9, 1e-9, 6e-9, 8e-9, 5e-9, 8.5e-9]
    pulled = forces(params, way)
    expected = [float(adhesive(z)[1]) for z in way[5:]]
    assert pulled[5:] == pytest.approx(expected, rel=1e-9)
    released = forces(params, [*way, 10e-9, 8e-9, 5e-9])
    assert max(map(abs, released[-3:])) < 1e-15


def test_a_reversal_in_contact_has_no_jump() -> None:
    z = np.linspace(0.0, 20e-9, 201)
    both = np.stack([np.maximum(4e-9 - z, 0.0) * 1.0, np.maximum(2.5e-9 - z, 0.0) * 1.0], axis=1)[None, None]
    params = params_of(hysteretic() | {"value": both, "z": z})
    way = np.concatenate([np.arange(200, 10, -1), np.arange(10, 30), np.arange(30, 5, -1)]) * 0.1e-9
    felt = np.array(forces(params, np.repeat(way, 10) + np.tile(np.linspace(0.0, -0.09e-9, 10), len(way))))
    # branches 1.5 nN apart, changed over two points of 0.1 nm: at most 7.5 nN/nm and the slope of the curves
    assert np.abs(np.diff(felt)).max() < 9e-9 * 0.2


def test_gates_are_where_the_curve_snaps_in_and_lets_go() -> None:
    made = hysteretic()
    onset, release = gates(checked_map(made, made.pop("value")))
    assert onset[0, 0] == pytest.approx(4e-9, abs=0.11e-9)
    assert release[0, 0] == pytest.approx(9e-9, abs=0.11e-9)


# The instrument


def rig_over(bench_of: Any, path: Path, **changes: Any) -> Rig:
    rig = Rig(bench_of("afm_node@slave"), config_of(path, **changes))
    rig.go(0.0)
    rig.control("arm", place="hand")
    return rig


def test_the_instrument_feels_the_curves_of_the_file(bench_of: Any, tmp_path: Path) -> None:
    rig = rig_over(bench_of, write_npz(tmp_path / "map.npz", hysteretic()))
    assert any("recorded map map.npz" in text and "201 points, approach and retract" in text for text in rig.said())
    for z_m in np.linspace(20e-9, 0.0, 60).tolist():
        state = rig.go(20e-9 - z_m, 3)
        assert state.base_position_m[2] == pytest.approx(z_m - 20e-9, rel=1e-9, abs=1e-18)
        # within the snap of 1 nN between two points of the file the curve has no value of its own
        if abs(z_m - 4e-9) > 0.2e-9:
            assert near(state.tip_force_n[2], float(adhesive(z_m)[0]), 1e-13)
        assert state.deflection_m == pytest.approx(state.tip_force_n[2] / 2.0, rel=1e-12, abs=1e-24)
        assert not state.separation_valid
    for z_m in (0.5e-9, 3e-9, 6e-9, 8.5e-9):
        assert near(rig.go(20e-9 - z_m, 10).tip_force_n[2], float(adhesive(z_m)[1]), 1e-13)
    assert rig.go(20e-9 - 12e-9, 10).tip_force_n[2] == 0.0


def test_the_tip_stays_on_the_map_and_the_rig_says_so_once(bench_of: Any, tmp_path: Path) -> None:
    rig = rig_over(bench_of, write_npz(tmp_path / "map.npz", members()))
    rig.said()
    state = rig.go(40e-9, 100)
    assert state.limited
    assert state.base_position_m[2] == pytest.approx(-20e-9, rel=1e-9)
    state = rig.go(0.0, 100, x_m=80e-9, y_m=-70e-9)
    assert state.base_position_m[:2] == pytest.approx((50e-9, -30e-9), rel=1e-9)
    told = [text for text in rig.said() if "the recorded map ends here" in text]
    assert len(told) == 1
    with pytest.raises(RefusedError, match=r"beyond the recorded map, x ± 5e-08 m, y ± 3e-08 m"):
        rig.control("set", **{"lateral.x_m": 0.0, "lateral.y_m": 31e-9})


def test_the_safe_state_is_the_top_of_the_map(bench_of: Any, tmp_path: Path) -> None:
    rig = rig_over(bench_of, write_npz(tmp_path / "map.npz", members()))
    rig.go(15e-9, 50)
    rig.control("stop")
    state = rig.go(0.0, 100)
    assert state.mode == "retracted"
    assert state.base_position_m[2] == pytest.approx(0.0, abs=1e-18)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cantilever": {"stiffness_n_per_m": 40.0}}, "contradicts sample.map"),
        ({"friction": {"coefficient": 0.2}}, "leave friction out"),
        ({"environment": "spring"}, "sample.map is for driver simulated"),
        ({"rest_distance_m": 1e-9, "safety": {"retract_position_m": 5e-9}}, "leave the tip no room to move"),
        ({"sample": {"map": "x.npz", "name": "dots"}}, "leave out name"),
    ],
)
def test_settings_that_contradict_a_map_are_refused(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    path = write_npz(tmp_path / "map.npz", members())
    with pytest.raises(ValueError, match=words):
        config_of(path, **changes)


# Files


def test_a_written_map_is_read_back_as_it_was(tmp_path: Path) -> None:
    made = hysteretic()
    whole = checked_map({key: value for key, value in made.items() if key != "value"}, made["value"])
    write_map(tmp_path / "map.npz", whole)
    again, digest = read_map(tmp_path / "map.npz")
    assert len(digest) == 16
    for before, after in zip(whole, again, strict=True):
        assert np.array_equal(before, after)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"unit": "kg"}, "unit: is 'kg'; it must be one of N, nN"),
        ({"unit": None}, "unit: is missing"),
        ({"length_unit": "inch"}, "length_unit: is 'inch'; it must be one of m, mm"),
        ({"stiffness_n_per_m": None}, "stiffness_n_per_m: is missing"),
        ({"stiffness_n_per_m": -1.0}, "stiffness_n_per_m: is -1.0; it must be a number above 0"),
        ({"unit": "mV"}, "sensitivity_m_per_v: is missing"),
        ({"sign": None}, "sign: is missing"),
        ({"axis": None}, "axis: is missing"),
        ({"z": np.linspace(20e-9, 0.0, 41)}, "z: must rise from point to point; after point 0"),
        ({"z": np.linspace(0.0, 4.0, 41) ** 2 * 1e-9}, "z: its points must be even"),
        ({"z": np.linspace(0.0, 20e-9, 40)}, "z: must be 41 finite numbers"),
        ({"z": np.linspace(0.0, 20.0, 41)}, "z: spans 20 m, more than 1 mm: is length_unit right"),
        ({"value": np.full((5, 4, 41), np.nan)}, "value: 820 of 820 values are not finite"),
        ({"value": np.zeros((5, 41))}, r"value: has the shape \(5, 41\)"),
        ({"value": None}, "value: is missing"),
    ],
)
def test_a_map_that_cannot_be_felt_is_refused_with_its_name_and_the_key(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    path = write_npz(tmp_path / "map.npz", members(**changes))
    with pytest.raises(ConfigError, match=rf"map\.npz: {words}"):
        read_map(path)


def test_a_truncated_map_is_refused(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "map.npz", members())
    whole = path.read_bytes()
    for share in (0.02, 0.5, 0.95):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ConfigError, match=r"map\.npz: "):
            read_map(path)


def test_a_map_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_npz(tmp_path / "map.npz", members())
    monkeypatch.setattr("telenano_lab.afm_files.force_map.MOST_VALUES", 800)
    with pytest.raises(ConfigError, match=r"map\.npz: value: has \d+ bytes, at most 6400 are read"):
        read_map(path)


def test_a_map_over_the_height_of_the_tip_is_brought_over_that_of_the_base(tmp_path: Path) -> None:
    z = np.linspace(0.0, 10e-9, 101)
    force = np.maximum(5e-9 - z, 0.0) * 6.0
    made = hysteretic() | {"value": force[None, None], "z": z, "axis": "tip"}
    whole, _ = read_map(write_npz(tmp_path / "map.npz", made))
    # on a spring of 6 N/m through a cantilever of 2 N/m, 1.5 N/m are felt
    base = whole.z_m
    assert np.abs(whole.values[0, 0, 0] - np.maximum(5e-9 - base, 0.0) * 1.5).max() < 2e-10
    with pytest.raises(ConfigError, match="axis: tip: with stiffness_n_per_m = 2 N/m the base would go back"):
        read_map(write_npz(tmp_path / "fold.npz", made | {"value": 6.0 * z[None, None]}))


def test_volts_become_newtons_by_sensitivity_and_stiffness(tmp_path: Path) -> None:
    made = members(unit="mV", sensitivity_m_per_v=50e-9, sign=-1)
    whole, _ = read_map(write_npz(tmp_path / "map.npz", made))
    assert whole.values[0] == pytest.approx(-made["value"] * 1e-3 * 50e-9 * 2.0, rel=1e-12, abs=0.0)

"""A recorded map is felt as it was measured: interpolation, both branches, the edges, and files that cannot be used."""

import math
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_maps import adhesive, force_n, hysteretic, members, near, write_3ds, write_curves, write_npz

from proto.errors import ConfigError, RefusedError
from services.afm_node.config import AfmConfig
from services.afm_node.instrument import driver_of
from services.afm_node.node import AfmNode
from services.afm_node.physics import recorded_map
from services.afm_node.physics.part import PlantInputs
from services.afm_node.physics.recorded_map import MapState, value_at
from services.afm_node.physics.sample.force_map import checked_map, gates, map_params, read_map, write_map
from services.afm_node.physics.sample.map_files import Wanted, import_map
from services.afm_node.physics.sample.map_libraries import blocks_of, refuse_large_archive
from services.numerics.compiled import compiled_form

SHARED = Path(__file__).parents[4] / "shared" / "data"


def params_of(made: dict[str, Any], rest_m: float = 20e-9) -> recorded_map.MapParams:
    made = dict(made)
    return map_params(checked_map(made, made.pop("value")), rest_m, 40.0, 1.0)


def forces(params: recorded_map.MapParams, heights: Any, x_m: float = 0.0, y_m: float = 0.0) -> list[float]:
    """Return the force at heights above the bottom, which the base goes through one after the other [N]."""
    state, felt = MapState(math.inf, 0.0, False, 0.0), []
    for z_m in heights:
        inputs = PlantInputs(params.rest_distance_m - z_m, x_m, y_m)
        state, sample = recorded_map.step(params, state, inputs, 1e-3)
        felt.append(sample.force_n)
    return felt


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


def config_of(path: Path, **changes: Any) -> AfmConfig:
    return AfmConfig.model_validate({"sample": {"map": str(path)}, "rest_distance_m": 20e-9, **changes})


class Rig:
    """An AFM over a recorded map on a bench."""

    def __init__(self, bench: Any, config: AfmConfig) -> None:
        self.bench, self.node = bench, AfmNode(bench.context, config, driver_of(config))

    def go(self, x_s_m: float, steps: int = 1, x_m: float = 0.0, y_m: float = 0.0) -> Any:
        """Command a base and a place a millisecond apart; return the last state."""
        for _ in range(steps):
            self.bench.advance_ms(1.0)
            fields = {"mode": "position", "base_position_m": (x_m, y_m, -x_s_m), "hand_seq": 1}
            sent = self.bench.received("afm/command", "controller@slave", **fields, hand_t_ns=self.bench.clock.now_ns())
            self.node.on_message(sent)
        return self.bench.take("afm/state")[-1]

    def control(self, command: str, **parameters: Any) -> str:
        fields = {"id": "a", "command": command, "target": "afm_node", "parameters": parameters}
        return self.node.on_control(self.bench.make("session/control", "console@master", **fields))

    def said(self) -> list[str]:
        return [event.text for event in self.bench.take("session/event")]


def rig_over(bench_of: Any, path: Path, **changes: Any) -> Rig:
    rig = Rig(bench_of("afm_node@slave"), config_of(path, **changes))
    rig.go(0.0)
    rig.control("arm")
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
        ({"friction": {"coefficient": 0.2}}, "no friction besides"),
        ({"environment": "spring"}, "sample.map is for driver simulated"),
        ({"rest_distance_m": 1e-9, "safety": {"retract_position_m": 5e-9}}, "leave the tip no way"),
        ({"sample": {"map": "x.npz", "name": "dots"}}, "it goes with no name"),
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
        ({"value": np.full((5, 4, 41), np.nan)}, "value: 820 of 820 values are no finite number"),
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
    monkeypatch.setattr("services.afm_node.physics.sample.force_map.MOST_VALUES", 800)
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


def test_force_curves_become_a_map_on_one_grid(tmp_path: Path) -> None:
    pytest.importorskip("afmformats")
    path, shares = write_curves(tmp_path / "curves.h5", 3, 2), []
    found = import_map(path, Wanted({}), shares.append)
    z = found.map.z_m
    assert found.map.values.shape == (2, 3, 2, len(z))
    assert (z[0], z[-1]) == pytest.approx((0.0, 20e-9), rel=1e-9)
    assert found.map.stiffness_n_per_m == 2.0
    assert np.diff(found.map.x_m) == pytest.approx(4e-8 / 3, rel=1e-9)
    down, up = adhesive(z)
    for i in range(3):
        for j in range(2):
            # the jumps of the curve are between two of its points
            assert np.count_nonzero(np.abs(found.map.values[0, i, j] - down) > 1e-14) <= 1
            assert np.count_nonzero(np.abs(found.map.values[1, i, j] - up) > 1e-14) <= 1
    assert shares and shares == sorted(shares) and shares[-1] == 1.0
    level = import_map(path, Wanted({}, level="common"))
    assert level.map.z_m[-1] == pytest.approx(20e-9 - 2.6e-9, rel=1e-3)
    assert level.notes[-1].startswith("87 %")


def test_force_curves_that_do_not_say_the_spring_constant_ask_for_it(tmp_path: Path) -> None:
    pytest.importorskip("afmformats")
    path = write_curves(tmp_path / "curves.h5", 2, 1, stiffness=None)
    with pytest.raises(ConfigError, match=r"curves\.h5: stiffness_n_per_m: is missing"):
        import_map(path, Wanted({}))
    assert import_map(path, Wanted({"stiffness_n_per_m": 3.0})).map.stiffness_n_per_m == 3.0


def test_a_large_archive_is_read_in_blocks_that_have_all_of_it(tmp_path: Path) -> None:
    path, names = tmp_path / "map.jpk-force-map", ["header.properties", "index/", "shared-data/header.properties"]
    names += [f"index/{number}/segments/0/data.dat" for number in range(130)]
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, name)
    read, shares = [], []
    for block, share in blocks_of(str(path), tmp_path):
        with zipfile.ZipFile(block) as archive:
            assert names[:3] == archive.namelist()[:3]
            read += archive.namelist()[3:]
            assert all(archive.read(name).decode() == name for name in archive.namelist())
        shares.append(share)
    assert read == names[3:]
    assert shares == [pytest.approx(64 / 130), pytest.approx(128 / 130), 1.0]


def write_archive(path: Path, entries: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def test_what_curves_share_is_bounded_and_what_is_not_read_of_it_is_not_copied(tmp_path: Path) -> None:
    curves = {f"index/{number}/header.properties": b"a" for number in range(130)}
    path = write_archive(tmp_path / "image.jpk-qi-data", {"data-image.jpk-qi-image": bytes(14 << 20), **curves})
    sizes = [Path(block).stat().st_size for block, _ in blocks_of(str(path), tmp_path)]
    assert len(sizes) == 3 and max(sizes) < 20_000
    path = write_archive(tmp_path / "shared.jpk-qi-data", {"header.properties": bytes(14 << 20), **curves})
    with pytest.raises(ValueError, match="its curves share 14680064 bytes of properties, at most 4194304 are read"):
        next(blocks_of(str(path), tmp_path))


def test_an_archive_that_names_bytes_twice_or_unpacks_to_a_multiple_is_refused(tmp_path: Path) -> None:
    sound = write_archive(tmp_path / "sound.zip", {f"{n}": os.urandom(100) for n in range(40)})
    refuse_large_archive(str(sound))
    bomb = write_archive(tmp_path / "bomb.zip", {f"{n}": bytes(14 << 20) for n in range(90)})
    with pytest.raises(ValueError, match="it unpacks to 1321205760 bytes, at most"):
        refuse_large_archive(str(bomb))
    # all entries of the directory at the end are the first of the file
    content = bytearray(sound.read_bytes())
    place = content.find(b"PK\x01\x02")
    while place >= 0:
        content[place + 42 : place + 46] = bytes(4)
        place = content.find(b"PK\x01\x02", place + 1)
    shared = tmp_path / "shared.zip"
    shared.write_bytes(content)
    with pytest.raises(ValueError, match="lie over one another"):
        refuse_large_archive(str(shared))


def test_a_plain_grid_in_hdf5_is_read_with_its_attributes(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    made = members()
    with h5py.File(tmp_path / "grid.h5", "w") as file:
        for name in ("value", "x", "y", "z"):
            file[name] = made.pop(name)
        file["value"].attrs["unit"] = made.pop("unit")
        file.attrs.update(made)
    found = import_map(tmp_path / "grid.h5", Wanted({}))
    assert np.array_equal(found.map.values[0], members()["value"])
    assert found.map.stiffness_n_per_m == 2.0


def test_a_grid_of_nanonis_is_read_with_both_ways(tmp_path: Path) -> None:
    from recorded_maps import frequency_shift_hz

    found = import_map(write_3ds(tmp_path / "grid.3ds"), Wanted({}))
    assert found.map.quantity == "frequency_shift"
    assert found.map.values.shape == (2, 4, 3, 64)
    expected = frequency_shift_hz(found.map.z_m)
    assert np.abs(found.map.values[0, 2, 1] - 1.02 * expected).max() < 1e-5
    assert np.abs(found.map.values[1, 0, 0] - 0.9 * expected).max() < 1e-5
    assert found.map.x_m == pytest.approx([-1.5e-9, -0.5e-9, 0.5e-9, 1.5e-9], rel=1e-9)
    current = import_map(tmp_path / "grid.3ds", Wanted({}, channel="current"))
    assert (current.map.quantity, len(current.map.values)) == ("current", 1)
    stopped = import_map(write_3ds(tmp_path / "stopped.3ds", lines=2), Wanted({}))
    assert stopped.map.values.shape == (2, 4, 2, 64)
    assert stopped.notes[0] == "the grid was stopped: 2 of 3 lines are whole and are taken"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"Grid dim": '"many"'}, "Grid dim: is 'many'"),
        ({"Sweep Signal": '"Bias (V)"'}, "Sweep Signal: is 'Bias .V.'; a map needs a sweep of Z"),
        ({"Points": "x"}, "Points: is 'x'; it must be a whole number"),
        ({"Points": "63"}, "is no whole .3ds file: "),
        ({"Channels": '"Current (A);LIX (A);LIY (A)"'}, "Channels: has no force and no frequency shift; choose one of"),
    ],
)
def test_a_grid_of_nanonis_that_cannot_be_used_is_refused(tmp_path: Path, changes: dict[str, str], words: str) -> None:
    with pytest.raises(ConfigError, match=rf"grid\.3ds: {words}"):
        import_map(write_3ds(tmp_path / "grid.3ds", **changes), Wanted({}))


def test_a_truncated_grid_of_nanonis_is_refused(tmp_path: Path) -> None:
    path = write_3ds(tmp_path / "grid.3ds")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ConfigError, match=r"grid\.3ds: is no whole \.3ds file"):
        import_map(path, Wanted({}))


@pytest.mark.parametrize(
    ("name", "given", "shape"),
    [
        ("fmt-jpk-fd_map2x2_extracted.jpk-force-map", {}, (2, 2, 2)),
        ("Z_spectroscopy.3ds", {}, (2, 32, 2)),
    ],
)
def test_public_files_become_maps(name: str, given: dict[str, Any], shape: tuple[int, ...]) -> None:
    if not (SHARED / name).exists():
        pytest.skip("measured data are not beside the project: ../shared/data")
    found = import_map(SHARED / name, Wanted(given))
    assert found.map.values.shape[:3] == shape
    assert np.isfinite(found.map.values).all()


def test_a_public_force_map_is_felt_within_the_noise_of_its_own_curves() -> None:
    afmformats = pytest.importorskip("afmformats")
    path = SHARED / "fmt-jpk-fd_map2x2_extracted.jpk-force-map"
    if not path.exists():
        pytest.skip("measured data are not beside the project: ../shared/data")
    found = import_map(path, Wanted({}, points=2000)).map
    params, curves = map_params(found, 1e-6, 40.0, 1.0), []
    for curve in afmformats.load_data(path):
        segment = np.asarray(curve["segment"]).astype(int)
        height, force = (np.asarray(curve[name]) for name in ("height (measured)", "force"))
        ways = [(height[part], force[part]) for part in (segment == segment[0], segment == segment[-1])]
        zero = min(way[0].min() for way in ways)
        place = [int(curve.metadata[f"grid index {axis}"] > 0) for axis in "xy"]
        curves.append((place, [way[0] - zero for way in ways], ways[0][1]))
    low = max(way.min() for _, ways, _ in curves for way in ways)
    for (i, j), (height, _), force in curves:
        order = np.argsort(height, kind="stable")
        z, own = height[order] - low, force[order] - np.mean(force[order][-(len(force) // 10) :])
        kept = (z >= 0.0) & (z < found.z_m[-1])
        felt = forces(params, z[kept][::-1], found.x_m[i], found.y_m[j])[::-1]
        error = np.array(felt) - own[kept]
        # 2 nN of force, and 5 pN of noise from point to point
        assert error.std() < 8e-12
        assert np.abs(error).max() < 5e-11

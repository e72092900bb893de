"""Recorded maps of instruments come onto one grid as they were measured, and what cannot be used is refused by name."""

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from instrument_files import write_3ds, write_curves
from recorded_maps import forces, frequency_shift_hz, members
from telenano_lab.afm_files.force_map import map_params
from telenano_lab.afm_files.map_files import MapOptions, import_map
from telenano_lab.afm_files.map_libraries import blocks_of, refuse_large_archive
from telenano_lab.doubles.maker_files import adhesive

from telenano.wire import ConfigError

SHARED = Path(__file__).parents[5] / "shared" / "data"


def test_force_curves_become_a_map_on_one_grid(tmp_path: Path) -> None:
    path, shares = write_curves(tmp_path / "curves.h5", 3, 2), []
    found = import_map(path, MapOptions({}), shares.append)
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
    level = import_map(path, MapOptions({}, level="common"))
    assert level.map.z_m[-1] == pytest.approx(20e-9 - 2.6e-9, rel=1e-3)
    assert level.notes[-1].startswith("87 %")


def test_force_curves_that_do_not_say_the_spring_constant_ask_for_it(tmp_path: Path) -> None:
    path = write_curves(tmp_path / "curves.h5", 2, 1, stiffness=None)
    with pytest.raises(ConfigError, match=r"curves\.h5: stiffness_n_per_m: is missing"):
        import_map(path, MapOptions({}))
    assert import_map(path, MapOptions({"stiffness_n_per_m": 3.0})).map.stiffness_n_per_m == 3.0


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
    with pytest.raises(ValueError, match="overlap"):
        refuse_large_archive(str(shared))


def test_a_plain_grid_in_hdf5_is_read_with_its_attributes(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    made = members()
    with h5py.File(tmp_path / "grid.h5", "w") as file:
        for name in ("value", "x", "y", "z"):
            file[name] = made.pop(name)
        file["value"].attrs["unit"] = made.pop("unit")
        file.attrs.update(made)
    found = import_map(tmp_path / "grid.h5", MapOptions({}))
    assert np.array_equal(found.map.values[0], members()["value"])
    assert found.map.stiffness_n_per_m == 2.0


def test_a_grid_of_nanonis_is_read_with_both_ways(tmp_path: Path) -> None:
    found = import_map(write_3ds(tmp_path / "grid.3ds"), MapOptions({}))
    assert found.map.quantity == "frequency_shift"
    assert found.map.values.shape == (2, 4, 3, 64)
    expected = frequency_shift_hz(found.map.z_m)
    assert np.abs(found.map.values[0, 2, 1] - 1.02 * expected).max() < 1e-5
    assert np.abs(found.map.values[1, 0, 0] - 0.9 * expected).max() < 1e-5
    assert found.map.x_m == pytest.approx([-1.5e-9, -0.5e-9, 0.5e-9, 1.5e-9], rel=1e-9)
    current = import_map(tmp_path / "grid.3ds", MapOptions({}, channel="current"))
    assert (current.map.quantity, len(current.map.values)) == ("current", 1)
    stopped = import_map(write_3ds(tmp_path / "stopped.3ds", lines=2), MapOptions({}))
    assert stopped.map.values.shape == (2, 4, 2, 64)
    assert stopped.notes[0] == "the grid was stopped: 2 of 3 lines are whole and are taken"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"Grid dim": '"many"'}, "Grid dim: is 'many'"),
        ({"Sweep Signal": '"Bias (V)"'}, "Sweep Signal: is 'Bias .V.'; a map needs a sweep of Z"),
        ({"Points": "x"}, "Points: is 'x'; it must be a whole number"),
        ({"Points": "63"}, "is not a complete .3ds file: "),
        ({"Channels": '"Current (A);LIX (A);LIY (A)"'}, "Channels: has no force and no frequency shift; choose one of"),
    ],
)
def test_a_grid_of_nanonis_that_cannot_be_used_is_refused(tmp_path: Path, changes: dict[str, str], words: str) -> None:
    with pytest.raises(ConfigError, match=rf"grid\.3ds: {words}"):
        import_map(write_3ds(tmp_path / "grid.3ds", **changes), MapOptions({}))


def test_a_truncated_grid_of_nanonis_is_refused(tmp_path: Path) -> None:
    path = write_3ds(tmp_path / "grid.3ds")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ConfigError, match=r"grid\.3ds: is not a complete \.3ds file"):
        import_map(path, MapOptions({}))


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
    found = import_map(SHARED / name, MapOptions(given))
    assert found.map.values.shape[:3] == shape
    assert np.isfinite(found.map.values).all()


def test_a_public_force_map_is_felt_within_the_noise_of_its_own_curves() -> None:
    afmformats = pytest.importorskip("afmformats")
    path = SHARED / "fmt-jpk-fd_map2x2_extracted.jpk-force-map"
    if not path.exists():
        pytest.skip("measured data are not beside the project: ../shared/data")
    found = import_map(path, MapOptions({}, points=2000)).map
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


@pytest.mark.parametrize("unit", ["N", "nN"])
@pytest.mark.parametrize(
    ("offset_n", "tilt_n_per_m", "sign", "words"),
    [
        (0.0, 0.0, 1.0, ""),
        (5e-9, 0.0, 1.0, "in free air, its force is"),
        (-2e-9, 0.0, 1.0, "in free air, its force is -"),
        (0.0, 0.1, 1.0, "its base line is tilted"),
        (0.0, 0.0, -1.0, "is its sign turned"),
    ],
)
def test_what_a_grid_has_far_from_its_sample_is_said(
    tmp_path: Path, offset_n: float, tilt_n_per_m: float, sign: float, words: str, unit: str
) -> None:
    z = np.linspace(0.0, 100e-9, 101)
    force = sign * np.where(z < 20e-9, 1.0 * (20e-9 - z), 0.0) + offset_n + tilt_n_per_m * (z - z[-1])
    noise = np.random.default_rng(1).normal(0.0, 5e-11, (3, 4, 101))
    axes = {name: 1e-8 * np.arange(count) for name, count in (("x", 3), ("y", 4))}
    np.savez(
        tmp_path / "grid.npz", value=(force + noise) / (1e-9 if unit == "nN" else 1.0), z=z, **axes, unit=unit, sign=1,
        length_unit="m", axis="base", stiffness_n_per_m=1.0, source="made",
    )  # fmt: skip
    notes = import_map(tmp_path / "grid.npz", MapOptions({})).notes
    assert any(words in note for note in notes) if words else not notes


@pytest.mark.parametrize("seed", range(8))
def test_an_option_takes_off_what_a_grid_has_in_free_air_and_turns_its_sign(tmp_path: Path, seed: int) -> None:
    draw = np.random.default_rng(seed)
    count = int(draw.integers(60, 300))
    z = np.linspace(0.0, 10.0 ** draw.uniform(-7.5, -6.0), count)
    span_n, contact = 10.0 ** draw.uniform(-9.0, -7.0), draw.uniform(0.2, 0.6)
    true = span_n * np.maximum(1.0 - z / (contact * z[-1]), 0.0) * np.ones((3, 4, 1))
    offset, tilt = span_n * draw.uniform(-3.0, 3.0), span_n * draw.uniform(-1.0, 1.0) / z[-1]
    sign, tilted = draw.choice((-1.0, 1.0)), bool(seed % 2)
    levels = offset * (1.0 + 0.2 * draw.standard_normal((3, 4, 1)))
    force = true + levels + (tilt * z if tilted else 0.0)
    noise = draw.normal(0.0, 2e-3 * span_n, force.shape)
    axes = {name: 1e-8 * np.arange(n) for name, n in (("x", 3), ("y", 4))}
    np.savez(
        tmp_path / "grid.npz", value=sign * (force + noise), z=z, **axes, unit="N", sign=1, length_unit="m",
        axis="base", stiffness_n_per_m=1.0, source="made",
    )  # fmt: skip
    found = import_map(tmp_path / "grid.npz", MapOptions({"sign": int(sign)}, correct="tilt" if tilted else "offset"))
    assert np.abs(found.map.values[0] - true).max() < 0.03 * span_n
    assert any("is taken off" in note for note in found.notes)
    assert not any("free air, its force" in note or "turned" in note for note in found.notes)
    plain = import_map(tmp_path / "grid.npz", MapOptions({"sign": int(sign)}))
    assert np.abs(plain.map.values[0] - true).max() > 0.1 * span_n or abs(offset) < 0.2 * span_n


def test_curves_keep_what_they_have_in_free_air_where_a_person_wants_it(tmp_path: Path) -> None:
    z = np.linspace(0.0, 100.0, 101)
    force = 5.0 + np.maximum(20.0 - z, 0.0)
    rows = "".join(f"{a:.3f}\t{b:.5f}\n" for a, b in zip(z.tolist(), force.tolist(), strict=True))
    (tmp_path / "curve.txt").write_text(f"height [nm]\tforce [nN]\n{rows}", encoding="utf-8")
    given = {"stiffness_n_per_m": 1.0}
    for correct, level in ((None, 0.0), ("offset", 0.0), ("nothing", 5e-9)):
        found = import_map(tmp_path / "curve.txt", MapOptions(given, correct=correct)).map
        assert found.values[0, 0, 0, -1] == pytest.approx(level, abs=1e-15)

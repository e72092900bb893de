"""`telenano inspect` says what a file is taken for, and which command takes it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.afm_files.inspect_command import inspected as inspection
from telenano_lab.afm_files.map_files import MapOptions, import_map

from telenano.settings import read_by_package
from telenano.testing import invoke
from telenano.wire import ConfigError

DATA = Path(__file__).parents[5] / "shared" / "data"
ROWS = "".join(f"{n / 2:.1f}\t{1e-9 * (n % 7 + 1):.3e}\n" for n in range(400))


def inspected(path: Path) -> dict[str, Any]:
    done = invoke(["inspect", str(path), "--json"])
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout))


FILES = {
    "f [kHz]\tPSD [V^2/Hz]\n" + ROWS: ("a thermal spectrum", "calibrate stiffness --spectrum"),
    "z [nm]\tdeflection [V]\n" + ROWS: ("a force curve", "calibrate sensitivity --curve"),
    "z [nm]\tforce [nN]\n" + ROWS.replace(".", ","): ("a force curve", "curve --overlay"),
    "sent_ms\tdelay_ms\n" + ROWS: ("a log of a line", "link fit"),
    "# Value units: nm\n" + "1.5 2 3\n4 5 6\n7 8 9\n": ("a matrix of 3 x 3 heights", "scan --sample"),
    "".join(f"{n % 5}.5\n" for n in range(50)): ("one column: a record", "calibrate stiffness --record"),
    "a\tb\n" + ROWS: ("two columns without known units: a head such as", ""),
}


@pytest.mark.parametrize("place", range(len(FILES)))
def test_a_table_is_taken_for_what_its_head_says(place: int, tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    text = list(FILES)[place]
    path.write_text(text, encoding="utf-8")
    found = inspected(path)
    kind, command = FILES[text]
    assert found["taken_for"].startswith(kind)
    assert any(command in line for line in found["takes_it"]) or not command
    assert found["decimal_mark"] == ("comma" if "nN" in text else "point")


def test_units_that_are_not_known_and_cells_that_are_missing_are_named(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("z [furlong]\tforce [nN]\n1\t2\n2\tnan\n3\t4\n", encoding="utf-8")
    found = inspected(path)
    assert "NOT KNOWN: it will be refused" in found["columns"]["column 1"]
    assert "times 1e-09 in SI" in found["columns"]["column 2"] and "1 missing" in found["columns"]["column 2"]
    assert found["left_out"] == ["1 of 6 cells have no number"]


def test_what_ping_printed_is_named_and_an_empty_file_is_called_empty(tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    path.write_text("PING a\n[1.0] 64 bytes: icmp_seq=1 ttl=1 time=1 ms\n")
    assert inspected(path)["format"] == "what ping printed"
    path.write_text("")
    refused = invoke(["inspect", str(path), "--json"])
    assert refused.exit_code == 2 and "is empty" in json.loads(refused.stdout)["error"]
    path.write_bytes(np.arange(900, dtype=np.float32).tobytes())
    assert inspected(path)["takes_it"] == []


@pytest.mark.parametrize(
    ("name", "what"), [("SiN_FD_plot.ibw", "curve --overlay"), ("spot_1-1000nm.ibw", "scan --sample")]
)
def test_real_files_of_instruments_are_told_apart(name: str, what: str) -> None:
    if not (DATA / name).is_file():
        pytest.skip(f"{DATA / name} is not here: the measured files are beside the checkout, in ../shared/data")
    assert any(what in line for line in inspected(DATA / name)["takes_it"])


@pytest.mark.parametrize(
    "ending", [".txt", ".csv", ".dat", ".3ds", ".sxm", ".ibw", ".nid", ".jpk-force", ".gwy", ".spm"]
)
def test_an_empty_file_is_called_empty_whatever_takes_it(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"empty{ending}"
    path.write_bytes(b"")
    for what in ("heights", "curve", "deflections", "spectrum"):
        with pytest.raises(ConfigError, match="is empty"):
            read_by_package(path, what)
    for read in (inspection, lambda one: import_map(one, MapOptions({}))):
        with pytest.raises(ConfigError, match="is empty"):
            read(path)


@pytest.mark.parametrize("unit", ["dBV/√Hz", "V^2", "Vpk/√Hz", "Vrms", "dB re 1 V^2/Hz", "V^2/Hz"])
def test_a_spectrum_of_any_normalisation_is_one(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "s.txt"
    path.write_text(f"f [Hz]\tlevel [{unit}]\n" + "".join(f"{n}\t{n}.5\n" for n in range(1, 40)), encoding="utf-8")
    found = inspected(path)
    assert found["taken_for"] == "a thermal spectrum"
    assert "refused" not in str(found["columns"])


def test_what_was_assumed_of_a_curve_is_printed(tmp_path: Path) -> None:
    path = tmp_path / "c.txt"
    ways = [*range(200, -60, -1), *[-60] * 80, *range(-60, 200)]
    rows = "".join(f"{z}\t{max(-z, 0) * 0.1:.3f}\t{0.01 * (z % 7):.3f}\n" for z in ways)
    path.write_text(f"z [nm]\tDeflection [V]\tFriction [V]\n{rows}", encoding="utf-8")
    assumed = " ".join(inspected(path)["would_give"]["assumed"])
    assert "'Deflection [V]' over 'z [nm]'" in assumed and "(the height rests)" in assumed


@pytest.mark.parametrize("head_bytes", [10, 5_000, 300_000])
@pytest.mark.parametrize("ending", [".dat", ".txt", ".img"])
def test_numbers_behind_a_text_of_any_length_are_a_file_of_an_instrument(
    tmp_path: Path, ending: str, head_bytes: int
) -> None:
    path = tmp_path / f"image{ending}"
    numbers = np.arange(4_096, dtype="<f4").tobytes()
    path.write_bytes(b"Num.X=64\n".ljust(head_bytes, b"a") + b"\nDATA" + numbers)
    found = inspected(path)
    assert found["format"].startswith("a file of an instrument")
    assert found["takes_it"] == []
    assert found["refused"]

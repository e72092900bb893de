"""A curve in a text table has one meaning, however its columns, units, ways and signs are written."""

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.afm_files.curve_files import load_one
from telenano_lab.afm_files.text_curves import curves_of

from telenano.testing import invoke
from telenano.wire import ConfigError

POINTS, K, M_PER_V = 300, 0.5, 50e-9
LENGTHS = {"nm": 1e-9, "µm": 1e-6, "m": 1.0, "Å": 1e-10}
VALUES = {
    "force [nN]": 1e-9, "Force (pN)": 1e-12, "F / N": 1.0, "deflection [V]": M_PER_V * K,
    "Defl (mV)": 1e-3 * M_PER_V * K,
    "deflection [nm]": 1e-9 * K,
}  # fmt: skip


def force_n(height_m: np.ndarray, pull_n: float) -> np.ndarray:
    """Return a contact of 0.5 N/m below zero height, and a pull that falls off in 5 nm."""
    return np.where(height_m < 0.0, -K * height_m, 0.0) - pull_n * np.exp(-np.abs(height_m) / 5e-9)


def written(path: Path, length: str, value: str, rises: bool, turned: bool, separator: str, comma: bool) -> None:
    way = np.linspace(200e-9, -60e-9, POINTS)
    z = np.concatenate([way, way[::-1]])
    force = np.concatenate([force_n(way, 2e-9), force_n(way[::-1], 8e-9)])
    z = (1.0 if rises else -1.0) * z / LENGTHS[length]
    force = (-1.0 if turned else 1.0) * force / VALUES[value]
    text = "".join(f"{a:.9e}{separator}{b:.9e}\n" for a, b in zip(z, force, strict=True))
    text = text.replace(".", ",") if comma else text
    path.write_text(f"z [{length}]{separator}{value}\n{text}", encoding="utf-8")


@pytest.mark.parametrize(("length", "value"), list(product(LENGTHS, VALUES)))
@pytest.mark.parametrize(("separator", "comma"), [("\t", False), (";", True), (",", False)])
def test_a_curve_has_its_pull_off_and_contact_in_any_units(
    tmp_path: Path, length: str, value: str, separator: str, comma: bool
) -> None:
    for rises, turned in product((True, False), repeat=2):
        path = tmp_path / "curve.txt"
        written(path, length, value, rises, turned, separator, comma)
        facts, (base, deflection) = load_one(str(path), "0", repr(K), repr(M_PER_V))
        heights, forces = -base, K * deflection
        approach, retract = np.split(forces, [facts["turn"]])
        assert approach.min() == pytest.approx(-2e-9, rel=0.05)
        assert retract.min() == pytest.approx(-8e-9, rel=0.05)
        # it pushes where the height is least
        assert forces[np.argmin(heights)] == pytest.approx(30e-9, rel=0.02)


@pytest.mark.parametrize(
    ("head", "reason"),
    [
        ("", "a head with units, such as"),
        ("z\tforce", "a head with units, such as"),
        ("z [furlong]\tforce [nN]", "the unit .furlong. of .*is not known.*--set way_unit gives another"),
        ("t [s]\tforce [nN]", "a head with units, such as"),
    ],
)
def test_a_table_that_names_no_height_or_no_force_is_refused_with_what_to_write(
    tmp_path: Path, head: str, reason: str
) -> None:
    path = tmp_path / "curve.txt"
    written(path, "nm", "force [nN]", True, False, "\t", False)
    _, _, rest = path.read_text(encoding="utf-8").partition("\n")
    path.write_text(f"{head}\n{rest}", encoding="utf-8")
    with pytest.raises((ValueError, ConfigError), match=reason):
        curves_of(str(path))


def test_two_pairs_of_columns_are_the_two_ways_and_one_way_is_taken_for_both(tmp_path: Path) -> None:
    way = np.linspace(200e-9, -60e-9, POINTS)
    rows = zip(1e9 * way, 1e9 * force_n(way, 2e-9), 1e9 * way, 1e9 * force_n(way, 8e-9), strict=True)
    path = tmp_path / "pairs.csv"
    head = "z approach [nm],force approach [nN],z retract [nm],force retract [nN]"
    path.write_text(head + "\n" + "".join(",".join(f"{v:.9e}" for v in row) + "\n" for row in rows), encoding="utf-8")
    facts, (_, deflection) = load_one(str(path), "0", repr(K))
    approach, retract = np.split(K * deflection, [facts["turn"]])
    assert approach.min() == pytest.approx(-2e-9, rel=0.05)
    assert retract.min() == pytest.approx(-8e-9, rel=0.05)
    rows = zip(1e9 * way, 1e9 * force_n(way, 2e-9), strict=True)
    path.write_text("z [nm],F [nN]\n" + "".join(f"{a:.9e},{b:.9e}\n" for a, b in rows), encoding="utf-8")
    facts, (base, deflection) = load_one(str(path), "0", repr(K))
    assert facts["turn"] == POINTS and len(base) == 2 * POINTS


def _plain(path: Path, head: str, before: str, separator: str) -> None:
    """Write a curve in nm and nN without units, with columns of other things before it."""
    way = np.linspace(200e-9, -60e-9, POINTS)
    z = 1e9 * np.concatenate([way, way[::-1]])
    force = 1e9 * np.concatenate([force_n(way, 2e-9), force_n(way[::-1], 8e-9)])
    rows = zip(z, force, strict=True)
    text = "".join(f"{before.format(n)}{a:.9e}{separator}{b:.9e}\n" for n, (a, b) in enumerate(rows))
    path.write_text(f"{head}\n{text}" if head else text, encoding="utf-8")


UNITS = {"way_unit": "nm", "value_unit": "nN"}
PLAIN = {
    "two columns": ("", "", "\t", {}),
    "two columns of names": ("z force", "", " ", {}),
    "columns by number": ("", "{};0.5;", ";", {"columns": "3,4"}),
    "columns by title": ("n,wanted,other", "{},", ",", {"columns": "wanted,other"}),
    "a column of points": ("index,z,force", "{},", ",", {}),
    "a unit that is not known": ("z [furlong];force [stone]", "", ";", {}),
}  # fmt: skip


@pytest.mark.parametrize("ending", [".txt", ".csv", ".dat", ".asc", ".tsv"])
@pytest.mark.parametrize("kind", PLAIN)
def test_a_curve_without_a_head_is_read_by_what_a_person_says_of_it(kind: str, ending: str, tmp_path: Path) -> None:
    head, before, separator, columns = PLAIN[kind]
    path = tmp_path / f"curve{ending}"
    _plain(path, head, before, separator)
    facts, (base, deflection) = load_one(str(path), "0", repr(K), None, json.dumps({**UNITS, **columns}))
    approach, retract = np.split(K * deflection, [facts["turn"]])
    assert (approach.min(), retract.min()) == (pytest.approx(-2e-9, rel=0.05), pytest.approx(-8e-9, rel=0.05))
    assert np.ptp(base) == pytest.approx(260e-9, rel=1e-6)
    with pytest.raises((ValueError, ConfigError), match="--set way_unit"):
        load_one(str(path), "0", repr(K), None, json.dumps(columns))


@pytest.mark.parametrize(
    "command",
    [pytest.param(["curve", "--out", "OUT", "--overlay", "FILE"], marks=pytest.mark.check("fits and draws a curve")),
     ["sample", "import", "FILE", "--out", "OUT.npz"],
     ["sample", "info", "FILE"], ["inspect", "FILE"]],
)  # fmt: skip
def test_each_command_that_reads_curves_asks_for_what_is_not_named_by_the_option_that_gives_it(
    command: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "curve.txt"
    _plain(path, "", "{}\t", "\t")
    words = [word.replace("FILE", str(path)).replace("OUT", str(tmp_path / "out")) for word in command]
    constant = [] if command[0] == "inspect" else ["--set", f"stiffness_n_per_m={K}"]
    answer = invoke([*words, *constant, "--json"]).output
    given: list[str] = []
    for option in ("columns=2,3", "way_unit=nm", "value_unit=nN"):
        if command[0] != "inspect":
            assert f"--set {option.partition('=')[0]}=" in answer
        given += ["--set", option]
        done = invoke([*words, *constant, *given, "--json"])
        answer = done.output
    assert done.exit_code == 0, answer
    assert "furlong" in invoke([*words, *constant, "--set", "way_unit=furlong"]).output
    if command[0] == "inspect":
        assert json.loads(done.stdout)["would_give"]["least_value"] == pytest.approx(-8e-9, rel=0.05)


def test_a_file_that_says_its_own_units_takes_none_from_a_person(tmp_path: Path) -> None:
    path = tmp_path / "curve.jpk-force"
    path.write_bytes(b"PK")
    with pytest.raises(ValueError, match="are for a text table"):
        load_one(str(path), "0", "1.0", None, json.dumps(UNITS))

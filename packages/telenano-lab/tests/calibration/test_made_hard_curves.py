"""Curves on a hard sample with defects: the sensitivity is found or the curve refused, and what is left out named."""

import json
from pathlib import Path

import pytest
from made_hard_curves import KINDS, UNKNOWN, Kind, hold, outcome, slip, two_columns, written
from telenano_lab.calibration.hard_curves import curve_of, sensitivity_of_curve

from telenano.testing import invoke
from telenano.wire import ConfigError

FEW = 8


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_no_curve_gives_a_wrong_sensitivity(kind: Kind, tmp_path: Path) -> None:
    found = [outcome(kind, seed, tmp_path) for seed in range(FEW)]
    assert not any(one.is_wrong for one in found)
    if kind not in UNKNOWN:
        assert sum(one.share is None for one in found) <= 0.4 * FEW


@pytest.mark.endurance
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_of_200_curves_of_a_kind_at_most_two_are_wrong(kind: Kind, tmp_path: Path) -> None:
    found = [outcome(kind, seed, tmp_path) for seed in range(1000, 1200)]
    assert sum(one.is_wrong for one in found) <= 2
    if kind not in UNKNOWN:
        taken = [one for one in found if one.errors is not None]
        assert len(taken) >= 0.6 * len(found)
        assert sum(abs(one.errors or 0.0) < 2.0 for one in taken) >= 0.86 * len(taken)


def test_what_is_left_out_of_a_curve_is_named(tmp_path: Path) -> None:
    path = tmp_path / "c.txt"
    path.write_text(written(hold, 3)[0], encoding="utf-8")
    file = curve_of(path)
    said = " ".join(sensitivity_of_curve(file.way_m, file.volts).remarks)
    assert "taken: approach" in said and "left out: rest" in said and "retraction" in said
    path.write_text(written(slip, 1)[0], encoding="utf-8")
    file = curve_of(path)
    assert "a step of" in " ".join(sensitivity_of_curve(file.way_m, file.volts).remarks)


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        (("z [nm]", "Deflection 1 [V]", "Deflection 2 [V]"), "each may be a deflection: --columns X Y"),
        (("separation [nm]", "deflection [V]", "Lateral [V]"), "is a separation of tip and sample"),
    ],
)
def test_two_candidates_are_refused_with_the_option_that_chooses(
    columns: tuple[str, ...], reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "c.txt"
    path.write_text(two_columns(*columns), encoding="utf-8")
    with pytest.raises(ConfigError, match=reason):
        curve_of(path)
    assert curve_of(path, columns=("1", "2")).way_m.max() > 1e-7


@pytest.mark.parametrize("names", [("Lateral", "Vertical"), ("Friction", "Defl"), ("Torsion", "Auslenkung")])
def test_a_lateral_signal_is_no_deflection(names: tuple[str, str], tmp_path: Path) -> None:
    path = tmp_path / "c.txt"
    path.write_text(two_columns("z [nm]", f"{names[0]} [V]", f"{names[1]} [V]"), encoding="utf-8")
    assert sensitivity_of_curve(*curve_of(path)[:2]).m_per_v == pytest.approx(50e-9, rel=0.01)


@pytest.mark.check("draws a figure")
def test_the_command_prints_the_parts_and_draws_them(tmp_path: Path) -> None:
    path, picture = tmp_path / "c.txt", tmp_path / "c.png"
    text, truth = written(hold, 3)
    path.write_text(text, encoding="utf-8")
    words = ["calibrate", "sensitivity", "--curve", str(path), "--figure", str(picture), "--json"]
    document = json.loads(invoke(words).stdout)
    assert document["sensitivity_nm_per_v"] == pytest.approx(truth, rel=0.01)
    assert any("left out" in remark for remark in document["remarks"])
    assert picture.read_bytes().startswith(b"\x89PNG")

"""The equations of the paper give what was computed for them independently."""

import base64

import numpy as np
import pytest
from telenano_lab.microscopy.curve_models import ModelRow
from telenano_lab.studies.pages import reproduce as module
from telenano_lab.studies.pages.live_figures import TactilePath
from telenano_lab.studies.pages.reproduce import FIGURES, equations, reproduce

from telenano.wire import RigError


def test_every_equation_is_within_the_digits_of_its_expected_value():
    rows = equations()
    assert len(rows) >= 40
    # every erratum, and every equation but those that Eq. 7-11 and 15-17 share a number with
    places = " ".join(row.where for row in rows)
    assert all(f"E{number}" in places for number in range(1, 9))
    assert all(f"Eq. {number}" in places for number in (*range(1, 9), 12, 13, 14, 15, 16))
    for row in rows:
        # the expected values have three digits at least: half of the last one of 19.6
        assert abs(row.difference) < 3e-3, row


def test_a_page_has_the_curve_and_its_numbers(tmp_path):
    seen = []
    summary = reproduce(("equations", "fig6"), tmp_path, 8, lambda *args: seen.append(args))
    page = (tmp_path / "reproduce.html").read_text()
    assert "data:image/png;base64" in page
    assert "hand-over distance h*" in page
    assert summary["fig6"]["stiffness_n_per_m"] == 8.0
    assert seen[-1] == ("fig6", 2000, 2000)
    # the pull-off stands out of the noise of the bridge, 2.3 nN of a sample
    clean, noisy = (summary[name]["pull_off_force_n"] for name in ("fig6", "fig6_with_noise"))
    assert noisy == pytest.approx(clean, rel=0.0, abs=4.0 * 2.3e-9)
    assert noisy != clean
    assert page.count("data:image/png;base64") == 2


@pytest.fixture
def stand_ins(monkeypatch, tmp_path):
    """Recordings of rigs that were not run, and a comparison of models that costs nothing."""

    def run(name, out, progress):
        folder = out / name
        folder.mkdir()
        (folder / "fig12.png").write_bytes(b"\x89PNG of fig12")
        (folder / "summary.json").write_text('{"holds": [{"hand_n": 1.0, "ratio": 1.05}]}')
        progress(1, 1)
        return folder / "session.mcap"

    way = np.linspace(0.0, 50e-9, 200)
    surface = 1e-9 * np.sin(way / 8e-9)
    path = TactilePath(way, surface / 1e-6, surface, way / 30e-9, 1e-6)
    row = ModelRow(**dict.fromkeys(ModelRow._fields, 1.0))
    monkeypatch.setattr(module, "run_scenario", run)
    monkeypatch.setattr(module, "tactile_path", lambda recording: path)
    monkeypatch.setattr(module, "compare_models", lambda progress: [row])
    return monkeypatch


@pytest.mark.check("makes all figures of the paper")
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/")
def test_one_page_has_every_figure_and_the_table(stand_ins, tmp_path):
    seen = set()
    summary = reproduce(FIGURES, tmp_path, 8, lambda name, n, of: seen.add(name))
    page = (tmp_path / "reproduce.html").read_text()
    for words in ("Fig. 5", "Fig. 6", "Fig. 8", "Fig. 10", "Fig. 12", "Eq. 15-17, E8", "Eq. 4 in full"):
        assert words in page
    assert page.count("<p>The paper: ") == 5
    # Fig. 6 is there without its noise and with it
    assert page.count("data:image/png;base64") == 6
    assert base64.b64encode(b"\x89PNG of fig12").decode() in page
    assert set(summary) == {*FIGURES, "fig6_with_noise"}
    assert summary["fig12"] == {"holds": [{"hand_n": 1.0, "ratio": 1.05}]}
    assert summary["fig10"]["rms_at_the_hand_m"] == 0.0
    # what has a way to go says how far it is
    assert seen == set(FIGURES) - {"equations", "models"}


def test_a_rig_that_does_not_run_costs_its_own_figure_alone(stand_ins, tmp_path):
    def run(name, out, progress):
        raise RigError(f"{name}: the rig did not run: <a rig is running already>")

    stand_ins.setattr(module, "run_scenario", run)
    summary = reproduce(("equations", "fig10", "fig12"), tmp_path, 8, lambda *args: None)
    page = (tmp_path / "reproduce.html").read_text()
    assert page.count("Not made: fig1") == 2
    assert "&lt;a rig is running already&gt;" in page
    assert sorted(summary["failed"]) == ["fig10", "fig12"]
    assert "hand-over distance" in page

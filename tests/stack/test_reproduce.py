"""The whole page of the paper, as a person makes it: rigs for Fig. 10 and 12 included."""

import json
from pathlib import Path

import pytest
from stack_rig import Rig

pytestmark = [pytest.mark.stack, pytest.mark.endurance]


def test_all_figures_and_the_table_come_on_one_page(rig: Rig, tmp_path: Path) -> None:
    done = rig.telenano("reproduce", "all", "--pixels", "32", "--out", str(tmp_path), "--json", patience_s=240.0)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    page = (tmp_path / "reproduce.html").read_text()
    assert page.count("data:image/png;base64") == 5
    assert all(abs(row["difference"]) < 3e-3 for row in summary["equations"])
    # the hand goes over two dots of 10 nm, lower by what the sample gives way and the flanks it is too slow for
    assert summary["fig10"]["correlation"] > 0.95
    assert 8e-3 < summary["fig10"]["greatest_at_the_hand_m"] < 11e-3
    assert summary["fig8"]["rms_error_m"] < 0.5e-9
    # before the hand pushes, 1 N, 2 N, and after it has let go
    assert [hold["hand_force_n"] for hold in summary["fig12"]["holds"]] == [0.0, 1.0, 2.0, 0.0]
    assert {hold["verdict"] for hold in summary["fig12"]["holds"]} == {"stable"}
    for row in summary["models"]:
        assert abs(row["pull_off_share"]) < 2e-3

from pathlib import Path
from typing import Any

import pytest
import yaml

from services.launcher.plan import (
    DEFAULT_SITE_FILE,
    LAUNCHER,
    START_ORDER,
    STOP_ORDER,
    UpRequest,
    anchored,
    known_scenarios,
    make_plan,
)
from services.runtime.config import read_yaml
from services.runtime.main import load_site


def request(out: Path, **changes: Any) -> UpRequest:
    fields: dict[str, Any] = {
        "scenario": "fig12",
        "site_file": DEFAULT_SITE_FILE,
        "delay_ms": None,
        "duration_s": None,
        "out": out,
        "overwrite": False,
        "settings": (),
    }
    return UpRequest(**{**fields, **changes})


def test_every_packaged_scenario_is_sound(tmp_path: Path) -> None:
    assert "fig12" in known_scenarios()
    for name in known_scenarios():
        assert make_plan(request(tmp_path / name, scenario=name), tmp_path).scenario.name == name


def test_the_packaged_site_has_the_whole_rig() -> None:
    assert set(load_site(DEFAULT_SITE_FILE).nodes) >= {LAUNCHER, *START_ORDER}
    assert set(START_ORDER) == set(STOP_ORDER)
    assert START_ORDER[0] == STOP_ORDER[-1] == "recorder@master"


def test_flags_reach_the_effective_scenario_that_the_nodes_read(tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder"
    settings = ("controller.period_s=0.002", "delay_node.forward.delay_s=9.0")
    plan = make_plan(request(out, delay_ms=1e-5, duration_s=3, settings=settings), tmp_path)
    plan.prepare_folder()
    written = read_yaml(plan.scenario_file)
    assert written["duration_s"] == 3
    assert written["delay_node"]["forward"]["delay_s"] == 1e-5 / 1000.0
    assert written["delay_node"]["backward"]["delay_s"] == 1e-5 / 1000.0
    assert written["controller"]["period_s"] == 0.002
    assert written["recorder"] == {"directory": str(out), "file_name": "session.mcap"}
    # what was written is read back as what was checked
    again = make_plan(request(tmp_path / "b", scenario=str(plan.scenario_file)), tmp_path)
    assert again.scenario.delay_node == plan.scenario.delay_node


def test_the_environment_lies_below_the_flags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO__DELAY_NODE__FORWARD__DELAY_S", "0.5")
    assert make_plan(request(tmp_path), tmp_path).scenario.delay_node["forward"]["delay_s"] == 0.5
    assert make_plan(request(tmp_path, delay_ms=0.0), tmp_path).scenario.delay_node["forward"]["delay_s"] == 0.0


def test_overwrite_clears_an_earlier_session_and_nothing_else(tmp_path: Path) -> None:
    ours = ["session.mcap", "session_1.mcap", "fig12.png", "summary.json"]
    for name in [*ours, "notes.txt"]:
        (tmp_path / name).write_text("old")
    make_plan(request(tmp_path, overwrite=True), tmp_path).prepare_folder()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "scenario.yaml"]


def test_file_names_in_a_scenario_are_meant_from_its_folder(tmp_path: Path) -> None:
    tree = yaml.safe_load("{a: {delay_trace: {file: t.csv}, table_file: /abs/x, file: null, profile: file}, n: 1}")
    assert anchored(tree, tmp_path) == {
        "a": {
            "delay_trace": {"file": str(tmp_path / "t.csv")},
            "table_file": "/abs/x",
            "file": None,
            "profile": "file",
        },
        "n": 1,
    }

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from telenano.launcher.plan import ALLOW_REPLAY, UpRequest, make_plan
from telenano.launcher.run import disk_warning
from telenano.runtime.bus.address_book import AddressBook
from telenano.settings import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.settings.config import read_yaml
from telenano.settings.included import anchored, known_scenarios
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import LAUNCHER, OPTIONAL_NODES, PAGE, RECORDER, START_ORDER, STOP_ORDER


def request(out: Path, **changes: Any) -> UpRequest:
    fields: dict[str, Any] = {
        "scenario": "fig12",
        "site_file": DEFAULT_SITE_FILE,
        "duration_s": None,
        "out": out,
        "overwrite": False,
        "settings": (),
    }
    lists = {name: tuple(value) for name, value in changes.items() if isinstance(value, list)}
    return UpRequest(**{**fields, **changes, **lists})


def test_every_packaged_scenario_is_sound(tmp_path: Path) -> None:
    assert "fig12" in known_scenarios()
    for name in known_scenarios():
        assert make_plan(request(tmp_path / name, scenario=name), tmp_path).scenario.name == name


def test_the_packaged_site_has_the_whole_rig() -> None:
    assert set(AddressBook.load(DEFAULT_SITE_FILE).nodes) >= {LAUNCHER, *START_ORDER}
    assert set(STOP_ORDER) == {*START_ORDER, *OPTIONAL_NODES, PAGE}
    # the recorders receive from the others as they come and go
    assert START_ORDER[0] == RECORDER
    assert set(STOP_ORDER[-2:]) == {RECORDER, "recorder@slave"}


def test_flags_reach_the_effective_scenario_that_the_nodes_read(tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder"
    settings = ("controller.period_s=0.002", "delay_node.forward.delay_s=9.0")
    plan = make_plan(request(out, round_trip_ms=2e-5, duration_s=3, settings=settings), tmp_path)
    plan.prepare_folder()
    written = read_yaml(plan.scenario_file)
    assert written["duration_s"] == 3
    assert written["delay_node"]["forward"]["delay_s"] == 0.5e-3 * 2e-5
    assert written["delay_node"]["backward"]["delay_s"] == 0.5e-3 * 2e-5
    assert written["controller"]["period_s"] == 0.002
    assert written["recorder"] == {"directory": str(out), "file_name": "session.mcap"}
    # what was written is read back as what was checked
    again = make_plan(request(tmp_path / "b", scenario=str(plan.scenario_file)), tmp_path)
    assert again.scenario.delay_node == plan.scenario.delay_node


def test_the_environment_lies_below_the_flags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO__DELAY_NODE__FORWARD__DELAY_S", "0.5")
    assert make_plan(request(tmp_path), tmp_path).scenario.delay_node["forward"]["delay_s"] == 0.5
    assert make_plan(request(tmp_path, round_trip_ms=0.0), tmp_path).scenario.delay_node["forward"]["delay_s"] == 0.0


def test_what_replaces_a_key_of_a_profile_is_said_with_where_it_came_from(tmp_path: Path) -> None:
    satellite = {"settings": ("delay_node.profile=satellite",)}
    assert make_plan(request(tmp_path, **satellite), tmp_path).warning == ""
    plan = make_plan(request(tmp_path, round_trip_ms=40.0, **satellite), tmp_path)
    assert plan.warning == (
        "fig12 + --set + --round-trip-ms: delay_node: the profile satellite is changed: "
        "forward.delay_s is 0.02, not 0.31, backward.delay_s is 0.02, not 0.29"
    )
    # where no link is started its settings are those of whoever starts it
    without_delay = {"settings": ("delay_node.profile=satellite", "delay_node.forward.delay_s=0")}
    assert make_plan(request(tmp_path, **without_delay), tmp_path).warning != ""
    at_slave = request(tmp_path, site="slave", site_file=TWO_SITES_FILE, **without_delay)
    assert make_plan(at_slave, tmp_path).warning == ""


def test_a_sample_that_is_too_stiff_for_the_law_is_named(tmp_path: Path) -> None:
    spring = ("controller.law=wave", "afm_node.environment=spring")
    borne = request(tmp_path, settings=(*spring, "afm_node.spring.stiffness_n_per_m=440"))
    assert make_plan(borne, tmp_path).stiffness_warning == ""
    stiff = make_plan(request(tmp_path, settings=(*spring, "afm_node.spring.stiffness_n_per_m=500")), tmp_path)
    assert stiff.stiffness_warning.startswith("law wave: 500 N/m is stiffer than the 444.4 N/m")
    lossy = (*spring, "afm_node.spring.stiffness_n_per_m=200", "delay_node.forward.loss.probability=0.2")
    told = make_plan(request(tmp_path, settings=lossy), tmp_path).stiffness_warning
    assert told.startswith("law wave: 200 N/m is stiffer than the 194.4 N/m that its slave half tolerates over a line")
    # Nobody knows beforehand what a network between two machines does.
    two = request(tmp_path, site="slave", site_file=TWO_SITES_FILE, settings=lossy[:-1])
    assert make_plan(two, tmp_path).stiffness_warning == told
    assert make_plan(request(tmp_path, settings=lossy[:-1]), tmp_path).stiffness_warning == ""
    # a tip over a sample is felt through its cantilever
    assert make_plan(request(tmp_path, settings=("controller.law=wave",)), tmp_path).stiffness_warning == ""


@pytest.mark.parametrize(
    ("latency_ms", "stiffness", "warned"), [(4.0, 70.0, True), (4.0, 69.0, False), (0.0, 70.0, False)]
)
def test_a_real_instrument_that_is_too_late_for_its_cantilever_is_named(
    tmp_path: Path, latency_ms: float, stiffness: float, warned: bool
) -> None:
    text = (Path(__file__).parents[3] / "packages" / "telenano-devices" / "docs" / "devices.md").read_text("utf-8")
    (stage,) = (yaml.safe_load(block) for block in re.findall(r"```yaml\n(schema: 1\ninstrument:.*?)```", text, re.S))
    stage["cantilever"]["stiffness_n_per_m"] = stiffness
    (tmp_path / "stage.yaml").write_text(yaml.safe_dump({**stage, "latency_s": 1e-3 * latency_ms}))
    driver = f"afm_node.modbus={{calibration: {tmp_path / 'stage.yaml'}}}"
    settings = ("controller.law=model_mediated", "afm_node.driver=modbus", driver)
    warning = make_plan(request(tmp_path, settings=settings), tmp_path).stiffness_warning
    assert ("answers 4 ms late (400 N/m without that)" in warning) is warned
    # a file that is on the other machine is that machine's affair
    (tmp_path / "stage.yaml").unlink()
    assert make_plan(request(tmp_path, settings=settings), tmp_path).stiffness_warning == ""


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


def test_a_file_that_is_named_at_the_command_line_lies_where_the_command_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "delays.txt").write_text("0.01 0.02")
    tree = {"jitter": {"table_file": "delays.txt"}}
    assert anchored(tree, tmp_path / "scenarios") == {"jitter": {"table_file": str(tmp_path / "delays.txt")}}
    (tmp_path / "scenarios").mkdir()
    beside = tmp_path / "scenarios" / "delays.txt"
    beside.write_text("0.03")
    assert anchored(tree, tmp_path / "scenarios") == {"jitter": {"table_file": str(beside)}}


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("delay_node.forward.jitter={distribution: table, table_file: absent.txt, scale_s: 1}",
         "delay_node.forward.jitter.table_file: HERE/absent.txt: is not a file"),
        ("delay_node.backward.delay_trace.file=absent.txt",
         "delay_node.backward.delay_trace.file: HERE/absent.txt: is not a file"),
        ("afm_node.sample.name=mine.gsf", "afm_node.sample.name: mine.gsf is neither a file nor a known shape"),
    ],
)  # fmt: skip
def test_a_file_that_is_not_there_is_named_where_one_types_before_anything_starts(
    tmp_path: Path, setting: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=f"fig12 .*{said.replace('HERE', str(tmp_path))}"):
        make_plan(request(tmp_path, settings=(setting,)), tmp_path)


def test_replay_is_allowed_to_the_devices_by_their_settings(tmp_path: Path) -> None:
    plan = make_plan(request(tmp_path, allow_replay=True), tmp_path)
    assert plan.scenario.afm_node["allow_replay"] is True
    assert plan.scenario.haptic_node["allow_replay"] is True
    assert len(ALLOW_REPLAY) == 2


def test_attached_plans_start_nothing_and_leave_the_scenario_to_the_nodes(tmp_path: Path) -> None:
    plan = make_plan(request(tmp_path, attach=True, duration_s=3.0, wait_s=7.0), tmp_path)
    assert plan.nodes == ()
    assert set(plan.others) == {*START_ORDER} - {RECORDER}
    assert (plan.launcher, plan.scenario.duration_s, plan.wait_s) == (LAUNCHER, 3.0, 7.0)
    plan.prepare_folder()
    assert list(tmp_path.iterdir()) == []


def test_attached_plans_never_touch_a_recording(tmp_path: Path) -> None:
    # a recorder that runs elsewhere may write to this very folder
    for name in ("session.mcap", "session_1.mcap"):
        (tmp_path / name).write_text("precious")
    make_plan(request(tmp_path, attach=True), tmp_path)
    (tmp_path / "summary.json").write_text("old")
    with pytest.raises(ConfigError, match=r"summary\.json exists already"):
        make_plan(request(tmp_path, attach=True), tmp_path)
    make_plan(request(tmp_path, attach=True, overwrite=True), tmp_path).prepare_folder()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["session.mcap", "session_1.mcap"]


def test_attaching_needs_no_recorder_in_the_site_file(tmp_path: Path) -> None:
    document = read_yaml(DEFAULT_SITE_FILE)
    del document["nodes"][RECORDER]
    site_file = tmp_path / "site.yaml"
    site_file.write_text(yaml.safe_dump(document))
    make_plan(request(tmp_path / "out", attach=True, site_file=site_file), tmp_path)
    with pytest.raises(ConfigError, match="recorder@master is missing"):
        make_plan(request(tmp_path / "out", site_file=site_file), tmp_path)


def test_a_node_of_the_other_site_is_not_left_out_here(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"--without afm_node: no such node, .*haptic_node@master"):
        make_plan(request(tmp_path, site_file=None, site="master", without=("afm_node",)), tmp_path)


def test_the_sites_share_the_rig_and_the_slave_is_awaited_by_the_master(tmp_path: Path) -> None:
    plans = {site: make_plan(request(tmp_path, site=site, site_file=None), tmp_path) for site in ("master", "slave")}
    assert plans["slave"].site_file == TWO_SITES_FILE
    assert plans["slave"].nodes == ("recorder@slave", "afm_node@slave", "controller@slave")
    assert plans["slave"].others == ()
    assert plans["slave"].launcher == "launcher@slave"
    assert plans["master"].nodes == tuple(node for node in START_ORDER if node.endswith("@master"))
    assert plans["master"].others == ("afm_node@slave", "controller@slave")
    started = {node for plan in plans.values() for node in plan.nodes}
    assert started == {*START_ORDER, "recorder@slave"}


def test_a_site_may_have_no_recorder_but_needs_its_launcher(tmp_path: Path) -> None:
    document = read_yaml(TWO_SITES_FILE)
    site_file = tmp_path / "site.yaml"
    del document["nodes"]["recorder@slave"]
    site_file.write_text(yaml.safe_dump(document))
    slave = request(tmp_path / "out", site="slave", site_file=site_file)
    assert make_plan(slave, tmp_path).nodes == ("afm_node@slave", "controller@slave")
    del document["nodes"]["launcher@slave"]
    site_file.write_text(yaml.safe_dump(document))
    with pytest.raises(ConfigError, match="launcher@slave is missing"):
        make_plan(slave, tmp_path)


@pytest.mark.parametrize(("key", "value"), [("directory", "/elsewhere"), ("file_name", "other.mcap")])
def test_where_up_records_is_given_by_out_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, value: str
) -> None:
    with pytest.raises(ConfigError, match=rf"--set: recorder\.{key}: .* in the folder of --out: give that option"):
        make_plan(request(tmp_path / "out", settings=[f"recorder.{key}={value}"]), tmp_path)
    monkeypatch.setenv(f"TELENANO__RECORDER__{key.upper()}", value)
    with pytest.raises(ConfigError, match=rf"environment: recorder\.{key}: "):
        make_plan(request(tmp_path / "out"), tmp_path)


@pytest.mark.parametrize(
    ("settings", "free", "warned"),
    [
        ((), 3_000_000, "has 3.0 MB left, and a session of 8 s takes about 4.8 MB"),
        ((), 5_000_000, ""),
        ((), None, ""),
        (("recorder.compression=none",), 5_000_000, "takes about 28.0 MB"),
        (("recorder.quota_bytes=1000000",), 3_000_000, ""),
        # how much this writes is not known
        (("recorder.topics=[afm/*]",), 0, ""),
    ],
)
def test_the_disk_is_compared_with_what_a_session_takes(
    tmp_path: Path, settings: tuple[str, ...], free: int | None, warned: str
) -> None:
    plan = make_plan(request(tmp_path / "out", settings=settings, duration_s=8.0), tmp_path)
    found = disk_warning(plan, lambda path: free)
    assert warned in found if warned else not found
    assert not disk_warning(make_plan(request(tmp_path / "out", without=["recorder"]), tmp_path), lambda path: 0)

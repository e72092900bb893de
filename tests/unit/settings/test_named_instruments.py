"""Named instruments: keys below those of a scenario, each number in a key that exists and with a source or a reason."""

import re
from pathlib import Path
from typing import Any

import pytest

import telenano
from telenano.launcher.plan import UpRequest, make_plan
from telenano.settings.afm_disturbances import DisturbanceConfig, instrument_name
from telenano.settings.config import flatten, merge, read_yaml, validate
from telenano.settings.named_instruments import instrument_named, instrument_names, on_instrument
from telenano.settings.scenario import LoadedScenario
from telenano.wire.errors import ConfigError

AFM = "afm_node.disturbances"


@pytest.mark.parametrize("name", instrument_names())
def test_each_key_of_an_instrument_exists(name: str) -> None:
    section = instrument_named(name).scenario.get("afm_node", {}).get("disturbances", {})
    validate(DisturbanceConfig, section, name, AFM)


@pytest.mark.parametrize("name", ["real", "real_drifting"])
def test_each_disturbance_of_a_real_instrument_has_a_source_or_is_named_as_assumed(name: str) -> None:
    found = instrument_named(name)
    told = " ".join([*(source.taken for source in found.source), *found.assumed]).lower()
    words = {
        **{"hysteresis": "hysteresis", "creep": "creep", "stage": "stage", "drift": "drift"},
        **{"thermal": "k_b t", "readout": "piezoresistive"},
    }
    section = found.scenario["afm_node"]["disturbances"]
    assert section.keys() == words.keys()
    assert all(part["enabled"] for part in section.values())
    assert [key for key, word in words.items() if word not in told] == []


def test_the_noise_of_the_read_out_is_that_of_its_source() -> None:
    readout = instrument_named("real").scenario["afm_node"]["disturbances"]["readout"]
    # 0.1 angstrom RMS from 10 Hz to 1 kHz, of which half the rate of a node, 500 Hz, is the end; 6.25 mV/nm (Eq. 3)
    white_m, flicker_m = readout["white_v"] / 6.25e6, readout["flicker_v"] / 6.25e6
    octaves = 5.64  # from 10 to 500 Hz
    assert (white_m**2 * 490.0 / 500.0 + flicker_m**2 * octaves / 12.0) ** 0.5 == pytest.approx(10e-12, rel=0.05, abs=0)


def test_the_two_real_instruments_differ_in_their_drift_alone() -> None:
    one, other = (flatten(instrument_named(name).scenario) for name in ("real", "real_drifting"))
    differing = {key: (value, other[key]) for key, value in one.items() if other[key] != value}
    assert differing == {f"{AFM}.drift.speed_m_per_s": (10e-12, 50e-12)}


def test_the_keys_of_a_scenario_stand_over_those_of_its_instrument() -> None:
    document = {
        "instrument": "real",
        "afm_node": {"rest_distance_m": 5e-9, "disturbances": {"creep": {"enabled": False}}},
    }
    found = on_instrument(document)
    assert found["afm_node"]["rest_distance_m"] == 5e-9
    assert found["afm_node"]["disturbances"]["creep"] == {"enabled": False, "share_per_decade": 0.015}
    assert found["afm_node"]["disturbances"]["drift"] == {"enabled": True, "speed_m_per_s": 10e-12}
    assert on_instrument(found) == found
    assert on_instrument({"name": "a"}) == {"name": "a"}


def test_an_instrument_reaches_the_scenario_that_the_nodes_read(tmp_path: Path) -> None:
    given = UpRequest(scenario="fig12", instrument="real_drifting", out=tmp_path, settings=(f"{AFM}.seed=7",))
    plan = make_plan(given, tmp_path)
    plan.prepare_folder()
    written = read_yaml(plan.scenario_file)
    assert written["instrument"] == "real_drifting"
    assert written["afm_node"]["disturbances"]["drift"] == {"enabled": True, "speed_m_per_s": 50e-12}
    assert written["afm_node"]["disturbances"]["seed"] == 7


def test_an_instrument_of_a_name_is_that_of_its_keys_one_by_one() -> None:
    named = telenano.simulate(duration_s=0.1, instrument="real")
    given = flatten(instrument_named("real").scenario)
    by_keys = telenano.simulate(duration_s=0.1, settings=given)
    quiet = telenano.simulate(duration_s=0.1)
    assert (named["tip_force_n"] == by_keys["tip_force_n"]).all()
    assert (named["tip_force_n"] != quiet["tip_force_n"]).any()
    assert (named.conditions.instrument, by_keys.conditions.instrument) == ("real", "disturbed")
    assert "instrument real" in named.conditions.title()
    assert "instrument" not in quiet.conditions.title()


@pytest.mark.parametrize(
    ("name", "section", "expected"),
    [
        ("ideal", {}, "ideal"),
        ("ideal", {"disturbances": {"seed": 3, "drift": {"speed_m_per_s": 1e-9}}}, "ideal"),
        ("ideal", {"disturbances": {"drift": {"enabled": True}}}, "disturbed"),
        ("real", {"disturbances": {"seed": 3}}, "real"),
        ("real", {"disturbances": {"creep": {"enabled": False}}}, "real, changed"),
        ("ideal", {"driver": "modbus"}, "modbus"),
        ("of_another_laboratory", {"disturbances": {"drift": {"enabled": True}}}, "of_another_laboratory"),
    ],
)
def test_a_session_states_its_instrument(name: str, section: dict[str, Any], expected: str) -> None:
    known = on_instrument({"instrument": name, "afm_node": section})["afm_node"] if "other" not in name else section
    assert instrument_name(name, known) == expected


def test_an_instrument_of_a_laboratory_is_a_file_in_the_folder_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ours.yaml").write_text("about: ours\nscenario: {afm_node: {disturbances: {drift: {enabled: true}}}}\n")
    with pytest.raises(ConfigError, match=re.escape(f"set TELENANO_INSTRUMENTS={tmp_path} and name it as ours")):
        instrument_named(str(tmp_path / "ours.yaml"))
    monkeypatch.setenv("TELENANO_INSTRUMENTS", str(tmp_path))
    assert instrument_named("ours").about == "ours"
    (tmp_path / "theirs.yaml").write_text("about: theirs\nscenario: {afm_node: {rest_distance_m: 1.0e-9}}\n")
    with pytest.raises(
        ConfigError, match=r"theirs.yaml: scenario.afm_node.rest_distance_m: an instrument sets keys of"
    ):
        instrument_named("theirs")


def test_an_unknown_instrument_is_refused_with_what_was_meant() -> None:
    document = merge(
        read_yaml(Path(telenano.__file__).parent / "settings/scenarios/fig12.yaml"), {"instrument": "raal"}
    )
    with pytest.raises(
        ConfigError,
        match=r"unknown instrument 'raal'; did you mean real\? Known are ideal, paper_bridge, real, real_drifting",
    ):
        LoadedScenario.of(document, "here")
    with pytest.raises(ConfigError, match=r"instrument: Input should be a valid string"):
        LoadedScenario.of({**document, "instrument": 3}, "here")
    # that of a recording may be from elsewhere, and its keys are in it
    assert LoadedScenario.of(document, "a recording", is_whole=True).scenario.instrument == "raal"


def test_a_real_device_has_its_own_disturbances(tmp_path: Path) -> None:
    settings = ("afm_node.driver=modbus", "afm_node.modbus.calibration=stage.yaml")
    with pytest.raises(
        ConfigError, match=r"instrument: real disturbs a simulated AFM only, and afm_node\.driver is modbus"
    ):
        make_plan(UpRequest(scenario="fig12", instrument="real", out=tmp_path, settings=settings), tmp_path)

"""What a driver may be used with: the table, and its refusals in a plan and at a node."""

import dataclasses
import re
from pathlib import Path

import pytest

from telenano.devices.afm.capabilities import TABLE, refusal
from telenano.launcher.plan import UpRequest, make_plan, refused_laws
from telenano.sections.afm_section import TAKEN
from telenano.sections.controller_section import KNOWN_LAWS, ControllerConfig
from telenano.sections.program_table import PROGRAMS
from telenano.settings.known_packages import KNOWN_MODEL_LAWS
from telenano.wire.errors import ConfigError


def test_every_driver_of_the_node_has_a_row() -> None:
    assert set(TABLE) == {"simulated", "modbus"}
    assert set(TABLE) <= TAKEN


def test_an_instrument_with_all_abilities_is_refused_nothing() -> None:
    assert {refusal("simulated", program) for program in ("", *PROGRAMS)} == {""}
    assert refused_laws("simulated") == {}


def test_an_instrument_without_a_stage_takes_no_image(tmp_path: Path) -> None:
    assert refusal("modbus", "curve") == ""
    assert "scan moves the tip over the sample, and modbus moves it along z only" in refusal("modbus", "scan")
    calibration = f"afm_node.modbus={{calibration: {tmp_path / 'stage.yaml'}}}"
    begin = "afm_node.begin={program: scan}"
    settings = ("afm_node.driver=modbus", calibration, begin)
    request = UpRequest(scenario="fig12", settings=settings)
    with pytest.raises(ConfigError, match="scan moves the tip over the sample, and modbus moves it along z only"):
        make_plan(request, tmp_path)


def test_a_plan_gives_both_halves_the_laws_that_they_have_to_refuse_later(tmp_path: Path) -> None:
    nanonis = f"afm_node.nanonis={{calibration: {tmp_path / 'nanonis.yaml'}}}"
    settings = ("afm_node.driver=nanonis", nanonis, "controller.law=model_mediated")
    plan = make_plan(UpRequest(scenario="fig12", settings=settings), tmp_path)
    config = plan.loaded.section("controller", ControllerConfig)
    assert set(config.refused_laws) == {name for name, law in KNOWN_LAWS.items() if law.link_loop}
    assert config.refused_laws == refused_laws("nanonis")
    simulated = make_plan(UpRequest(scenario="fig12"), tmp_path)
    assert "refused_laws" not in (simulated.loaded.document.get("controller") or {})


def test_a_law_is_judged_by_what_it_says_of_itself_and_not_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 50 samples a second a law of a package whose hand meets a model is not refused, nor left out of the advice."""
    model = dataclasses.replace(KNOWN_LAWS["model_mediated"], name="somebodys_model")
    loop = dataclasses.replace(KNOWN_LAWS["wave"], name="somebodys_loop")
    monkeypatch.setitem(KNOWN_LAWS, "somebodys_model", model)
    monkeypatch.setitem(KNOWN_LAWS, "somebodys_loop", loop)
    refused = refused_laws("nanonis")
    assert "somebodys_model" not in refused and "somebodys_loop" in refused
    assert "(model_mediated, " in refused["somebodys_loop"] and "somebodys_model" in refused["somebodys_loop"]
    assert "bounded_model" not in refused and "bounded_model" in refused["wave"]


def test_a_refusal_names_the_package_of_a_law_that_would_do(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not any(KNOWN_LAWS[name].link_loop for name in KNOWN_MODEL_LAWS)
    for name in KNOWN_MODEL_LAWS:
        monkeypatch.delitem(KNOWN_LAWS, name)
    where = f"; the law {KNOWN_MODEL_LAWS[0]} is in the package telenano-laws: "
    assert re.search(rf"\({', '.join(KNOWN_MODEL_LAWS)}, .*{where}", refused_laws("nanonis")["wave"])


def test_a_driver_of_another_package_is_not_judged() -> None:
    assert refusal("somebodys_afm", "scan") == ""
    assert refused_laws("somebodys_afm") == {}


def test_attended_is_an_option_of_up(tmp_path: Path) -> None:
    plan = make_plan(UpRequest(scenario="fig12", attended=True), tmp_path)
    assert plan.scenario.afm_node["attended"] is True
    assert make_plan(UpRequest(scenario="fig12"), tmp_path).scenario.afm_node.get("attended") is None

"""What a driver may be used with: the table, and its refusals in a plan and at a node."""

from pathlib import Path

import pytest

from proto.errors import ConfigError
from services.afm_node.config import TAKEN
from services.afm_node.devices.capabilities import TABLE, refusal
from services.afm_node.programs.table import PROGRAMS
from services.controller.config import ControllerConfig
from services.controller.law_names import LAW_NAMES
from services.launcher.plan import UpRequest, make_plan


def test_every_driver_of_the_node_has_a_row() -> None:
    assert set(TABLE) == {"simulated", "modbus"}
    assert set(TABLE) <= TAKEN


def test_an_instrument_with_all_abilities_is_refused_nothing() -> None:
    assert {refusal("simulated", law, program) for law in LAW_NAMES for program in ("", *PROGRAMS)} == {""}


def test_an_instrument_without_a_stage_takes_no_image(tmp_path: Path) -> None:
    assert refusal("modbus", "wave", "curve") == ""
    assert "scan moves the tip over the sample, and modbus moves it along z only" in refusal("modbus", "wave", "scan")
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
    own = {law for law in config.refused_laws if law in LAW_NAMES}
    assert own == set(LAW_NAMES) - {"model_mediated", "tactile"}
    assert config.refused_laws["wave"] == refusal("nanonis", "wave")
    simulated = make_plan(UpRequest(scenario="fig12"), tmp_path)
    assert "refused_laws" not in (simulated.loaded.document.get("controller") or {})


def test_a_driver_of_another_package_is_not_judged() -> None:
    assert refusal("somebodys_afm", "wave", "scan") == ""


def test_attended_is_an_option_of_up(tmp_path: Path) -> None:
    plan = make_plan(UpRequest(scenario="fig12", attended=True), tmp_path)
    assert plan.scenario.afm_node["attended"] is True
    assert make_plan(UpRequest(scenario="fig12"), tmp_path).scenario.afm_node.get("attended") is None

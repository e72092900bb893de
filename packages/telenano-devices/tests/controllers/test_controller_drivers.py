"""The way of both drivers into telenano: found by their names, imported when a section names one, refused in words."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from telenano_devices.doubles.controller_line import Gwyscope, Nanonis
from telenano_devices.gwyscope import gwyscope_model
from telenano_devices.gwyscope.gwyscope_device import GWYSCOPE
from telenano_devices.gwyscope.gwyscope_driver import GwyscopeAfm
from telenano_devices.nanonis import nanonis_model
from telenano_devices.nanonis.nanonis_device import NANONIS
from telenano_devices.nanonis.nanonis_driver import NanonisAfm

from telenano.extend.instruments import DeviceError
from telenano.testing import afm_config, instrument_of, refused_laws, refused_program
from telenano.wire import ConfigError

LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "smith", "model_mediated", "tactile")
MODELS = {"gwyscope": gwyscope_model, "nanonis": nanonis_model}
KINDS = {"gwyscope": GwyscopeAfm, "nanonis": NanonisAfm}
DECLARED_S = {"gwyscope": GWYSCOPE.capabilities.latency_s, "nanonis": NANONIS.capabilities.latency_s}

IMPORTED = """
import json, sys
from telenano.testing import afm_config
def found():
    return sorted(name for name in sys.modules if name.startswith("telenano_devices"))
config = afm_config({"driver": "modbus", "modbus": {"calibration": "stage.yaml"}})
before = found()
named = afm_config({"driver": "gwyscope", "gwyscope": {"calibration": "gwyscope.yaml"}})
print(json.dumps([before, config.simulated, found()]))
"""


def calibration(kind: str, folder: Path, **changes: object) -> Path:
    path = folder / f"{kind}.yaml"
    path.write_text(yaml.safe_dump(MODELS[kind].calibration_of(6.25e6, 40.0) | changes))
    return path


def test_it_is_imported_when_a_section_names_it() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True)
    before, simulated, after = json.loads(done.stdout)
    assert (before, simulated) == ([], False)
    parts = ("controllers", "controllers.piezo_calibration", "gwyscope", "gwyscope.gwyscope_calibration")
    assert after == ["telenano_devices", *(f"telenano_devices.{part}" for part in (*parts, "gwyscope.gwyscope_device"))]


@pytest.mark.parametrize("kind", KINDS)
def test_a_section_gives_the_driver_at_the_address_that_it_names(kind: str, tmp_path: Path) -> None:
    section = {"calibration": str(calibration(kind, tmp_path)), "host": "afm.example", "port": 7000}
    driver = instrument_of({"driver": kind, kind: section, "attended": True})
    assert type(driver) is KINDS[kind]
    assert (driver.calibration.network.host, driver.calibration.network.port) == ("afm.example", 7000)
    assert driver.heartbeat_s == 0.0
    guarded = instrument_of({"driver": kind, kind: {"calibration": section["calibration"]}})
    assert guarded.heartbeat_s == guarded.calibration.heartbeat_s > 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_section_that_is_not_there_is_named(kind: str) -> None:
    with pytest.raises(ValueError, match=f"driver: {kind} needs a section {kind} with calibration"):
        afm_config({"driver": kind})


def test_a_file_of_the_other_controller_is_refused_by_its_key(tmp_path: Path) -> None:
    path = calibration("nanonis", tmp_path)
    with pytest.raises(ConfigError, match="controller: Input should be 'gwyscope', got 'nanonis'"):
        instrument_of({"driver": "gwyscope", "gwyscope": {"calibration": str(path)}})


@pytest.mark.parametrize("kind", KINDS)
def test_before_a_tick_is_measured_it_is_as_late_as_it_declares(kind: str, tmp_path: Path) -> None:
    def latency_s(**changes: object) -> float:
        section = {"calibration": str(calibration(kind, tmp_path, **changes))}
        return float(instrument_of({"driver": kind, kind: section}).latency_s)

    assert latency_s() == pytest.approx(DECLARED_S[kind], rel=1e-9)
    assert latency_s(latency_s=7e-3) == 7e-3


def test_a_nanonis_that_pushes_its_samples_waits_for_no_tap(tmp_path: Path) -> None:
    section = {"calibration": str(calibration("nanonis", tmp_path, logger_port=6590))}
    assert instrument_of({"driver": "nanonis", "nanonis": section}).latency_s == pytest.approx(2.5e-3, rel=1e-9)


def test_a_gwyscope_is_refused_no_law_and_no_program() -> None:
    programs = ("", "scan", "curve", "path", "tactile", "push")
    assert {refused_program("gwyscope", program) for program in programs} == {""}
    assert refused_laws("gwyscope") == {}


@pytest.mark.parametrize("controller", [Gwyscope, Nanonis])
def test_without_a_guard_and_without_a_person_it_is_refused_and_not_driven(controller: Callable[..., Any]) -> None:
    line = controller(guarded=False)
    line.model.z_m = 3e-7
    command = f"telenano device guard {controller.__name__.lower()}"
    with pytest.raises(DeviceError, match=rf"has no guard in front of it, .*{command}.*--attended"):
        line.driver.open()
    assert line.model.z_m == 3e-7
    attended = controller(guarded=False, attended=True)
    attended.driver.open()
    assert attended.driver.report.status == "ok"

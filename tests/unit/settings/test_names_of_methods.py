"""A sample, law or driver of a package may have the name of a method of the model that its settings are in."""

from typing import Any

import pytest

from telenano.testing import install_package, said_with

PACKAGE = """
import dataclasses
from typing import NamedTuple

from telenano.settings import DeviceDriver
from telenano.laws import VirtualImpedanceParams
from telenano.sections import VIRTUAL_IMPEDANCE, ImpedanceConfig
from telenano.extend.programs import Program
from telenano.extend.samples import AfmSample, SampleModel
from telenano.settings import Settings
from telenano.numerics import compiled

class SampleParams(NamedTuple):
    stiffness_n_per_m: float

class SampleConfig(Settings):
    stiffness_n_per_m: float = 5.0

    def to_params(self):
        return SampleParams(self.stiffness_n_per_m)

@compiled
def start(params, base_m):
    return 0.0

@compiled
def measure(params, state, inputs, dt):
    force = params.stiffness_n_per_m * max(inputs.base_m, 0.0)
    return state, AfmSample(inputs.base_m, 0.0, force, 0.0, 0.0, False, force > 0.0, False, 0.0, 0.0)

SAMPLE = SampleModel("doubts", SampleConfig, SampleParams, start, measure, 5.0)

class Params(NamedTuple):
    impedance: VirtualImpedanceParams

class LawConfig(ImpedanceConfig):
    def to_params(self, period_s):
        return Params(self.impedance_params(period_s))

LAW = dataclasses.replace(VIRTUAL_IMPEDANCE, config=LawConfig, name="law_config")

class Knob(Settings):
    port: str = "a"

HAND = DeviceDriver("haptic_node", "to_params", Knob, lambda settings, limits: (settings.port, limits))
TIP = DeviceDriver("afm_node", "to_guard", Knob, lambda settings, limits: settings.port)
"""
ENTRIES = {
    "samples": {"doubts": "of_methods:SAMPLE"},
    "laws": {"law_config": "of_methods:LAW"},
    "devices": {"to_params": "of_methods:HAND", "to_guard": "of_methods:TIP"},
}
PROGRAM = """
import json
from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import DRIVERS, HapticConfig
from telenano.sections.controller_section import ControllerConfig, changed_config
from telenano.settings.config import validate
from telenano.devices.afm.instrument import driver_of
from telenano.wire.errors import ConfigError

def read(model, document, section):
    config = validate(model, document, "mine.yaml", section)
    again = validate(model, config.model_dump(), "again", section)
    return config, again == config, config.model_dump()

def refused(model, document, section):
    try:
        return str(read(model, document, section))
    except ConfigError as error:
        return str(error)

afm, kept, document = read(AfmConfig, {"environment": "doubts", "doubts": {"stiffness_n_per_m": 7.0}}, "afm_node")
said = {
    "sample": [kept, document["doubts"], afm.stiffest_n_per_m, afm.to_sample_params().plant[0], afm.doubts()],
    "sample refused": refused(AfmConfig, {"doubts": {"stifness_n_per_m": 7.0}}, "afm_node"),
    "attribute refused": refused(AfmConfig, {"package_doubts": {}}, "afm_node"),
}
tip, kept, document = read(AfmConfig, {"driver": "to_guard", "to_guard": {"port": "b"}}, "afm_node")
said["tip"] = [kept, document["to_guard"], driver_of(tip), tip.to_guard().base_max_m > 0.0]
hand, kept, document = read(HapticConfig, {"driver": "to_params", "to_params": {"port": "c"}}, "haptic_node")
driver = DRIVERS.find("to_params")
said["hand"] = [kept, document["to_params"], driver.device(hand, "limits", 1e-3)]
law, kept, document = read(ControllerConfig, {"law": "law_config", "law_config": {"force_gain": 3.0}}, "controller")
said["law"] = [kept, document["law_config"]["force_gain"], law.law_config().force_gain]
said["law changed"] = changed_config(law, {"law_config.force_gain": 4.0}).law_config().force_gain
said["law refused"] = refused(ControllerConfig, {"law_config": {"force_gain": -1.0}}, "controller")
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what a process with such a package says."""
    site = tmp_path_factory.mktemp("site")
    install_package(site, "of_methods", {"__init__.py": PACKAGE}, ENTRIES)
    found: dict[str, Any] = said_with(PROGRAM, site)
    return found


def test_a_sample_is_read_written_and_used_beside_the_method(said: dict[str, Any]) -> None:
    assert said["sample"] == [True, {"stiffness_n_per_m": 7.0}, 7.0, 7.0, ""]


def test_drivers_of_both_nodes_get_their_settings(said: dict[str, Any]) -> None:
    assert said["tip"] == [True, {"port": "b"}, "b", True]
    assert said["hand"] == [True, {"port": "c"}, ["c", "limits"]]


def test_a_law_is_chosen_and_changed_by_its_key(said: dict[str, Any]) -> None:
    assert said["law"] == [True, 3.0, 3.0]
    assert said["law changed"] == 4.0


def test_what_is_wrong_with_such_a_section_is_named_by_its_key(said: dict[str, Any]) -> None:
    assert (
        "afm_node.doubts.stifness_n_per_m: unknown key, did you mean stiffness_n_per_m? Known are stiffness_n_per_m"
        in said["sample refused"]
    )
    assert "afm_node.package_doubts: unknown key" in said["attribute refused"]
    assert "controller.law_config.force_gain" in said["law refused"]
    assert "allowed is from 0 to 1e+09" in said["law refused"]

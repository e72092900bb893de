"""What a machine says and does without the package of a driver, and what each node imports where it is installed."""

import importlib
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from telenano_devices.gwyscope import gwyscope_model
from telenano_devices.nanonis import nanonis_model
from telenano_lab.microscopy.force_curve import read_measured

from telenano.cli.commands.device import package_rows
from telenano.devices.afm.instrument import calibration_of_file
from telenano.launcher.plan import Plan, UpRequest, make_plan
from telenano.sections import afm_section as afm
from telenano.sections import hand_section as hand
from telenano.sections.surface_files import read_surface
from telenano.settings import plugins
from telenano.settings.config import validate
from telenano.settings.known_packages import KNOWN_PACKAGES, known_of
from telenano.wire import extras
from telenano.wire.errors import ConfigError

PACKAGE = "telenano-devices"
MODELS = {"gwyscope": gwyscope_model, "nanonis": nanonis_model}
NAMED = ("afm_node.driver=gwyscope", "afm_node.gwyscope={calibration: gwyscope.yaml}")

IMPORTED = """
import json, sys
from telenano.wire.nodes import SERVICES
from telenano.runtime.wiring.main import node_kind
for name in SERVICES:
    node_kind(name).config()
import telenano.cli.root, telenano.cli.commands.up
print(json.dumps(sorted({".".join(name.split(".")[:2]) for name in sys.modules if name.startswith("telenano_lab.")})))
"""

# A report of a recording where only what a lock of deploy/ names can be imported.
REPORTED = """
import re, sys
from importlib.metadata import packages_distributions
lock, recording, out = sys.argv[1:]
plain = lambda name: re.sub("[-_.]+", "-", name).lower()
locked = {plain(line.split("==")[0]) for line in open(lock) if "==" in line} | {"telenano"}
absent = {top for top, owners in packages_distributions().items() if not {plain(owner) for owner in owners} & locked}
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Refuse())
from pathlib import Path
from telenano.analysis.report import write_report
print(write_report(Path(recording), Path(out))["verdict"])
"""


def told(package: str) -> str:
    return f"{package}: {extras.how_to_add_package(package)}"


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let no package be installed."""
    for module in ("telenano.settings.plugins", "telenano.settings.device_drivers"):
        monkeypatch.setattr(f"{module}.installed", lambda kind: {})
    for drivers in (afm.DRIVERS, hand.DRIVERS):
        monkeypatch.setattr(drivers, "_asked", {})
    yield


def plan(site: str | None, folder: Path) -> Plan:
    request = UpRequest.model_validate({"scenario": "fig12", "settings": NAMED, "site": site})
    return make_plan(request, folder)


@pytest.mark.check("takes 2.1 s")
def test_no_node_imports_a_package_that_its_section_does_not_name() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True)
    # Every program that is installed has a section, and a rig can change to it while it runs.
    assert json.loads(done.stdout) == ["telenano_lab.assembly"]


@pytest.mark.check("takes 2.3 s")
def test_a_session_is_reported_with_what_its_image_and_the_demo_have(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    words = (root / "deploy/locks/rig.lock", root / "telenano/settings/demo.mcap", tmp_path)
    done = subprocess.run([sys.executable, "-c", REPORTED, *map(str, words)], capture_output=True, text=True)
    assert (done.stdout.strip(), done.stderr) == ("stable", "")
    assert (tmp_path / "fig12.png").exists()


@pytest.mark.usefixtures("bare")
def test_a_driver_and_a_file_that_need_a_package_name_it_and_its_command(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"the driver gwyscope is in the package {told(PACKAGE)}"):
        validate(afm.AfmConfig, {"driver": "gwyscope"}, "file", "afm_node")
    file = tmp_path / "gwyscope.yaml"
    file.write_text("controller: gwyscope\n")
    with pytest.raises(ConfigError, match=f"gwyscope.yaml: controller: gwyscope: .* {told(PACKAGE)}"):
        calibration_of_file(file)
    file.write_text("controller: somebodys\n")
    with pytest.raises(ConfigError, match="no driver is installed that has calibration files of this name"):
        calibration_of_file(file)


def test_every_command_of_every_package_names_its_package_where_it_is_absent() -> None:
    root = Path(__file__).parents[3]
    unnamed = []
    for project in sorted(root.glob("packages/*/pyproject.toml")):
        table = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
        for target in table.get("entry-points", {}).get("telenano.commands", {}).values():
            module, _, attribute = target.partition(":")
            for words in getattr(importlib.import_module(module), attribute):
                parts = words.split()
                prefixes = (" ".join(("command", *parts[:count])) for count in range(len(parts), 0, -1))
                named = next((KNOWN_PACKAGES[prefix] for prefix in prefixes if prefix in KNOWN_PACKAGES), None)
                if (named or "").partition("[")[0] != table["name"]:
                    unnamed.append((words, table["name"]))
    assert unnamed == []


def test_drivers_that_are_not_installed_are_listed_with_the_command_that_adds_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("telenano.cli.commands.device.installed", lambda kind: {})
    monkeypatch.setattr("telenano.cli.commands.doctor.checks_of_packages", list)
    rows = {row["driver"]: row for row in package_rows()}
    assert {name: row["package"] for name, row in rows.items()} == known_of("driver")
    assert rows["haply"]["advice"] == extras.how_to_add_package("telenano-devices")


def test_a_library_that_is_missing_is_named_with_the_extra_that_has_it() -> None:
    assert extras.missing("statsmodels") == (
        f"statsmodels is not installed: {extras.how_to_add_package('telenano-lab[experiments]')}"
    )
    assert extras.missing("rosbags").endswith(extras.how_to_add_package("telenano-bridges[ros2]"))


@pytest.mark.parametrize("environment", [".venv", "another"])
def test_a_checkout_adds_a_package_as_its_environment_was_made(
    environment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "_source", lambda: (True, "/a/telenano"))
    monkeypatch.setattr(sys, "prefix", f"/a/telenano/{environment}")
    expected = {
        ".venv": "make -C '/a/telenano' setup",
        "another": "pip install -e '/a/telenano/packages/telenano-lab[files]'",
    }
    assert extras.how_to_add_package("telenano-lab[files]") == expected[environment]


@pytest.mark.usefixtures("bare")
def test_a_file_that_needs_a_package_names_it_and_its_command(tmp_path: Path) -> None:
    for name, read in (("a.gwy", read_surface), ("a.sxm", read_surface), ("a.jpk-force", read_measured)):
        (tmp_path / name).write_text("no file of an instrument")
        with pytest.raises(ConfigError, match=rf"{name}: .* by the package {re.escape(told('telenano-lab[files]'))}"):
            read(tmp_path / name)


@pytest.mark.usefixtures("bare")
def test_a_master_is_planned_without_the_package_of_the_slave(tmp_path: Path) -> None:
    found = plan("master", tmp_path)
    assert found.scenario.afm_node["driver"] == "gwyscope"
    assert found.stiffness_warning == ""
    for site in (None, "slave"):
        with pytest.raises(ConfigError, match=f"the driver gwyscope is in the package {PACKAGE}"):
            plan(site, tmp_path)


@pytest.mark.parametrize(("driver", "late"), [("gwyscope", "4"), ("nanonis", "22.5")])
def test_an_instrument_of_a_package_that_is_too_late_for_its_cantilever_is_named(
    driver: str, late: str, tmp_path: Path
) -> None:
    file = tmp_path / "controller.yaml"

    def warned(stiffness_n_per_m: float, **changes: object) -> str:
        file.write_text(yaml.safe_dump(MODELS[driver].calibration_of(6.25e6, stiffness_n_per_m) | changes))
        named = (f"afm_node.driver={driver}", f"afm_node.{driver}={{calibration: {file}}}")
        settings = (*named, "controller.law=model_mediated")
        request = UpRequest.model_validate({"scenario": "fig12", "settings": settings})
        warning = make_plan(request, tmp_path).stiffness_warning
        file.unlink()
        # a file that is on the other machine is that machine's affair
        assert make_plan(request, tmp_path).stiffness_warning == ""
        return warning

    assert f"with an instrument that answers {late} ms late (400 N/m without that)" in warned(70.0)
    assert warned(70.0, latency_s=0.0) == warned(5.0) == ""


def test_with_the_package_a_master_refuses_what_the_instrument_cannot_do(tmp_path: Path) -> None:
    assert "nanonis" in plugins.installed("devices")
    settings = ("afm_node.driver=nanonis", "afm_node.nanonis={calibration: nanonis.yaml}", "controller.law=wave")
    request = UpRequest.model_validate({"scenario": "fig12", "settings": settings, "site": "master"})
    with pytest.raises(ConfigError, match="wave closes a loop through the instrument, and nanonis gives 50 samples"):
        make_plan(request, tmp_path)

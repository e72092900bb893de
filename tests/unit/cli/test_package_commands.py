"""Packages made by `telenano new` are laws, devices, operators and samples of the rig once they are installed."""

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import pytest
from typer.testing import CliRunner

from telenano.cli.commands import new as new_command
from telenano.cli.new_package import Kind, new_package
from telenano.cli.root import app
from telenano.extend.samples import AfmSample
from telenano.testing import said_with
from telenano.wire.errors import ConfigError

ROOT = Path(__file__).parents[3]
NAMES = {
    "law": "filtered",
    "operator": "trembling",
    "sample": "layered",
    "device": "stub_handle",
    "instrument": "stub_afm",
    "task": "gentle",
    "analysis": "slopes",
    "export": "lines",
    "package": "our_lab",
}

PROGRAM = """
import json
from types import SimpleNamespace
import numpy as np
from pydantic import ValidationError
from telenano.devices.afm.instrument import driver_of
from telenano.sections.afm_section import AfmConfig
from telenano.sections.controller_section import LAWS, OWN_LAWS, ControllerConfig
from telenano.extend.laws import HandSample
from telenano.lockstep.law_rules import broken_rules
from services.haptic_node.__main__ import device_of
from telenano.sections.hand_section import HapticConfig
from msgspec import msgpack
from telenano.wire.node_state import Part, part

import sys

imported = [sorted(name for name in ("telenano_stub_handle", "telenano_stub_afm") if name in sys.modules)]
HapticConfig.model_validate({"driver": "stub_handle"})
imported.append(sorted(name for name in ("telenano_stub_handle", "telenano_stub_afm") if name in sys.modules))

found = {"laws": [name for name in LAWS if name not in OWN_LAWS], "broken": broken_rules("filtered")}
found["imported"] = imported
config = ControllerConfig.model_validate({"law": "filtered", "filtered": {"filter_s": 0.0}})
found["kept_share"] = config.params().kept_share
state = LAWS["filtered"].master_start(config.params(), HandSample(1e-3, 0.0, 0.5, True))
def survives(state, start):
    kept = msgpack.decode(msgpack.encode(part(state)), type=Part)
    return kept.like(start) == state

found["state_survives"] = survives(state, state._replace())

haptic = HapticConfig.model_validate({"operator": {"kind": "trembling", "tremor_n": 0.5, "tremor_hz": 5.0}})
device = device_of(haptic)
device.open()
forces = [device.read(0.5 + 1e-3 * tick, 1e-3).operator_force_n for tick in range(200)]
found["forces"] = [min(forces), max(forces)]

afm = driver_of(AfmConfig.model_validate({"environment": "layered", "layered": {"layer_m": 1e-9}}))
afm.open()
found["tip_n"] = [afm.exchange(base_m).force_n for base_m in (0.0, 3.5e-9, 5e-9)]

handle = device_of(HapticConfig.model_validate({"driver": "stub_handle", "stub_handle": {"force_n": 0.25}}))
handle.open()
found["handle_n"] = handle.read(1.0, 1e-3).operator_force_n
found["reported"] = handle.report.status
handle.close()
found["simulated"] = HapticConfig.model_validate({"driver": "stub_handle"}).simulated

own = driver_of(AfmConfig.model_validate({"driver": "stub_afm", "stub_afm": {"stiffness_n_per_m": 40.0}}))
own.open()
found["own_instrument_n"] = own.exchange(5e-9).force_n
own.close()

from telenano.launcher.scenario_keys import scenario_schema

NAMES = ("stub_handle", "stub_afm")
parts = [scenario_schema()["properties"][node]["properties"] for node in ("haptic_node", "afm_node")]
found["sections"] = [
    [name for name in NAMES if name in where] for part in parts for where in (part, part["driver"]["enum"])
]

found["messages"] = []
from telenano.wire.errors import ConfigError
from telenano.settings.config import validate
for model, document in (
    (AfmConfig, {"stub_handle": {}}),
    (AfmConfig, {"driver": "stub_handle"}),
    (AfmConfig, {"driver": "stub_amf"}),
    (AfmConfig, {"stub_afm": {"stiffness_n_per_m": "stiff"}}),
):
    try:
        validate(model, document, "file", "afm_node")
    except ConfigError as error:
        found["messages"].append(str(error))

found["refused"] = []
for model, document in ((ControllerConfig, {"filtered": {"filter_s": -1.0}}), (AfmConfig, {"layered": {"k": 1.0}})):
    try:
        model.model_validate(document)
    except ValidationError as error:
        found["refused"] += [".".join(map(str, fault["loc"])) for fault in error.errors()]

from typer.testing import CliRunner
from telenano.cli.root import app

def said(*words):
    done = CliRunner().invoke(app, ["device", *words, "--json"])
    return {"code": done.exit_code, **json.loads(done.stdout)}

found["list"] = said("list")["packages"]
found["probe"] = [
    said("probe", "--device", "stub_handle"),
    said("probe", "--device", "stub_afm", "--set", "afm_node.stub_afm.stiffness_n_per_m=20"),
    said("probe", "--device", "stub_amf"),
    said("probe", "--device", "stub_afm", "--set", "haptic_node.stub_handle.force_n=1"),
    said("probe", "--device", "stub_afm", "--set", "afm_node.stub_afm.stiffness_n_per_m=0"),
]
found["monitor"] = [said("monitor", "--device", name, "--duration", "0.1") for name in ("stub_handle", "stub_afm")]
print(json.dumps(found))
"""


def put_on_path(package: Path, site: Path) -> None:
    """Do what an editable installation does: metadata with the entry points, and the package's folder on the path."""
    document: Mapping[str, Any] = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    info = site / f"{document['name'].replace('-', '_')}-{document['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {document['name']}\nVersion: {document['version']}\n")
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in entries.items())
        for group, entries in document["entry-points"].items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    site = tmp_path_factory.mktemp("site")
    folders = [site, ROOT]
    for kind, name in NAMES.items():
        new_package(kind, name, site / name)
        put_on_path(site / name, site)
        folders.append(site / name)
    document: dict[str, Any] = said_with(PROGRAM, site, PYTHONPATH=os.pathsep.join(map(str, folders)))
    return document


@pytest.mark.check("compiles the law")
def test_a_law_of_a_package_has_its_section_and_keeps_every_rule(found: dict[str, Any]) -> None:
    assert "filtered" in found["laws"]
    assert found["kept_share"] == 0.0
    assert len(found["broken"]) == 11
    assert not any(found["broken"].values()), found["broken"]
    assert found["state_survives"]


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_a_driver_is_imported_when_a_section_names_it(found: dict[str, Any]) -> None:
    assert found["imported"] == [[], ["telenano_stub_handle"]]


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_operator_sample_and_device_of_a_package_do_what_their_models_say(found: dict[str, Any]) -> None:
    assert found["forces"] == pytest.approx([0.5, 1.5], rel=1e-3)
    # 2 N/m over the layer of 1 nm, then 20 N/m
    assert found["tip_n"] == pytest.approx([0.0, 1e-9, 22e-9], rel=1e-9, abs=0.0)
    assert found["handle_n"] == 0.25
    assert not found["simulated"]
    assert found["reported"] in ("ok", "stale")
    # 40 N/m and 10 N/m in series, pressed by 5 nm
    assert found["own_instrument_n"] == pytest.approx(4e-8, rel=1e-9)


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_list_probe_and_monitor_know_the_drivers_of_packages(found: dict[str, Any]) -> None:
    rows = {row["driver"]: row for row in found["list"]}
    assert {name: (rows[name]["node"], rows[name]["found"]) for name in ("stub_handle", "stub_afm")} == {
        "stub_handle": ("haptic_node", "can be used"),
        "stub_afm": ("afm_node", "can be used"),
    }
    assert all(row["package"].startswith("telenano-") for row in rows.values())
    handle, instrument, misspelt, elsewhere, soft = found["probe"]
    assert (handle["code"], handle["kind"], handle["position_m"]) == (0, "admittance", 0.0)
    assert (instrument["code"], instrument["status"], instrument["force_n"]) == (0, "ok", 0.0)
    assert instrument["base_m"] == instrument["safe_position_m"] < 0.0
    assert (misspelt["code"], elsewhere["code"], soft["code"]) == (2, 2, 2)
    assert misspelt["error"].startswith("--device stub_amf: did you mean stub_afm? Known are dhd, ")
    assert elsewhere["error"] == "--set haptic_node: the driver stub_afm has keys afm_node.stub_afm.* only"
    assert soft["error"].startswith("--set: afm_node.stub_afm.stiffness_n_per_m: ")
    for watched in found["monitor"]:
        assert watched["code"] == 0
        assert watched["ticks"] > 10
        assert watched["driver_p99_s"] >= watched["driver_p50_s"] > 0.0
    assert all("sample_age_p50_s" in watched for watched in found["monitor"])


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_a_driver_is_no_name_of_the_other_node(found: dict[str, Any]) -> None:
    assert found["sections"] == 2 * [["stub_handle"]] + 2 * [["stub_afm"]]
    section, driver, misspelt, soft = found["messages"]
    assert section.startswith("file: afm_node.stub_handle: unknown key, known are ")
    assert driver.startswith("file: afm_node.driver: Input should be 'simulated', 'modbus'")
    assert driver.endswith(" or 'stub_afm', got 'stub_handle'")
    assert misspelt.endswith(" or 'stub_afm', got 'stub_amf'; did you mean stub_afm?")
    assert soft.startswith("file: afm_node.stub_afm.stiffness_n_per_m: Input should be a valid number")


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_what_is_wrong_in_the_section_of_a_package_is_named(found: dict[str, Any]) -> None:
    assert found["refused"] == ["filtered.filter_s", "layered.k"]


# What a change of neither of them cannot alter.
TEMPLATES = pytest.mark.drawn(0.0, "telenano/templates/", "telenano/cli/", "telenano/testing/", "telenano/extend/")


@pytest.mark.parametrize(
    "compiled",
    [
        pytest.param(False, marks=[pytest.mark.check("runs the tests of a package of each kind"), TEMPLATES]),
        pytest.param(True, marks=[pytest.mark.endurance, pytest.mark.timeout(900)]),
    ],
)
def test_every_package_passes_the_test_that_it_comes_with_as_it_is(compiled: bool, tmp_path: Path) -> None:
    folders, tests = [tmp_path, ROOT], []
    for kind, name in NAMES.items():
        new_package(kind, name, tmp_path / name)
        put_on_path(tmp_path / name, tmp_path)
        folders.append(tmp_path / name)
        tests.append(str(tmp_path / name / "tests"))
    # `make test` is without a compiler, whose work would take longer than the sessions
    paths = {"PYTHONPATH": os.pathsep.join(map(str, folders)), "NUMBA_DISABLE_JIT": str(int(not compiled))}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", *tests]
    done = subprocess.run(command, cwd=tmp_path, env={**os.environ, **paths}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\b(1[5-9]|2[0-9]) passed", done.stdout), done.stdout


def test_a_new_sample_gives_every_field_because_the_compiler_fills_in_none(tmp_path: Path) -> None:
    new_package("sample", "layered", tmp_path / "p")
    text = (tmp_path / "p" / "telenano_layered" / "__init__.py").read_text()
    made = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    given = [len(call.args) for call in made if getattr(call.func, "id", "") == "AfmSample"]
    assert given == [len(AfmSample._fields)]


@pytest.mark.endurance
@pytest.mark.timeout(1200)
def test_a_law_of_a_package_enters_the_benchmark_by_one_command(tmp_path: Path) -> None:
    new_package("law", "filtered", tmp_path / "filtered")
    put_on_path(tmp_path / "filtered", tmp_path)
    folders = [tmp_path, tmp_path / "filtered", ROOT]
    paths = {"PYTHONPATH": os.pathsep.join(map(str, folders)), "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-m", "telenano", "benchmark", "--quick", "--law", "filtered,position_force", "--json"]
    command += ["--workers", "2", "--out", str(tmp_path / "entry")]
    done = subprocess.run(command, cwd=tmp_path, env={**os.environ, **paths}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["laws"] == ["filtered", "position_force"]
    held = {row["law"]: row["held"] for row in found["rows"] if row["network"] == "clean"}
    assert held == {"filtered": 4, "position_force": 4}


@pytest.mark.parametrize("kind", get_args(Kind))
def test_a_new_package_compiles_and_names_its_entry(kind: str, tmp_path: Path) -> None:
    written = new_package(kind, "my_thing", tmp_path / "p")
    assert [path for path in written if not path.is_file()] == []
    document = tomllib.loads((tmp_path / "p" / "pyproject.toml").read_text())["project"]
    group = {"instrument": "devices", "analysis": "commands", "package": "scenarios"}.get(kind, f"{kind}s")
    assert document["entry-points"] == {f"telenano.{group}": {"my_thing": "telenano_my_thing:MY_THING"}}
    for path in written:
        text = path.read_text()
        assert "$" not in text
        if path.suffix == ".py":
            compile(text, str(path), "exec")
            assert max(map(len, text.splitlines())) <= 130


def test_a_name_that_cannot_be_one_and_a_folder_that_is_there_are_refused(tmp_path: Path) -> None:
    for name in ("My-Law", "1law", "class", "a" * 33):
        with pytest.raises(ConfigError, match="lower-case"):
            new_package("law", name, tmp_path / "new")
    with pytest.raises(ConfigError, match="exists already"):
        new_package("law", "my_law", tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("absent", "option"), [((), "--no-build-isolation "), (("editables",), "")])
def test_the_next_line_fetches_a_build_backend_only_where_it_is_absent(
    absent: tuple[str, ...], option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(new_command, "find_spec", lambda name: None if name in absent else name)
    result = CliRunner().invoke(app, ["new", "law", "my_law", "--out", str(tmp_path / "p")])
    assert result.stdout.splitlines()[-1] == f"next: pip install {option}-e {tmp_path / 'p'} && pytest {tmp_path / 'p'}"


def test_the_command_beside_a_kind_of_driver_makes_a_package_with_one(tmp_path: Path) -> None:
    text = (ROOT / "packages" / "telenano-devices" / "docs" / "fit.md").read_text(encoding="utf-8")
    rows = re.findall(r"with an? `(\w+Driver)` \| `telenano new ([\w-]+) NAME`", text)
    assert rows
    for driver, kind in rows:
        new_package(kind, "mine", tmp_path / kind)
        assert f"`{driver}`" in (tmp_path / kind / "telenano_mine" / "__init__.py").read_text(encoding="utf-8")


def test_a_node_is_that_of_a_device_alone(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["new", "law", "my_law", "--node", "afm_node", "--out", str(tmp_path / "p")])
    assert (result.exit_code, "--node: not without device" in result.output) == (2, True)
    assert not (tmp_path / "p").exists()
    made = CliRunner().invoke(app, ["new", "device", "mine", "--node", "afm_node", "--out", str(tmp_path / "p")])
    assert made.exit_code == 0, made.output
    assert "AfmReport" in (tmp_path / "p" / "telenano_mine" / "__init__.py").read_text(encoding="utf-8")

"""A machine without this package: scenarios of particles name it, and recordings with particles are read as ever."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from telenano_lab.assembly import bench

from telenano.settings import find_scenario
from telenano.virtual import ARMED_S, VirtualRig
from telenano.wire.extras import how_to_add_package

pytestmark = pytest.mark.check("records a session and starts processes, takes 10 s")

PACKAGE = "telenano-lab"
TOLD = f"is in the package {PACKAGE}: {how_to_add_package(PACKAGE)}"
SCENARIO = {
    "name": "pushed",
    "description": "The tip pushes one of two particles",
    "duration_s": 0.5,
    "haptic_node": {"operator": {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}]}},
    "afm_node": bench({"places": [[0.0, 0.0], [7e-7, 3e-8]]}, 1.0),
}
PUSH = {"program": "push", "push.x1_m": 2e-7, "push.approach_m_per_s": 5e-6}

PROGRAM = """
import json, sys
from pathlib import Path
from telenano.sections import AfmConfig
from telenano.sections.program_requests import requested
from telenano.launcher.plan import UpRequest, make_plan
from telenano.settings import find_scenario, validate
from telenano.testing import invoke
from telenano.wire.errors import TelenanoError

assert not any(name.startswith("telenano_lab.assembly") for name in sys.modules)
recording, out, assembly = sys.argv[1:]


def refusal(call):
    try:
        return f"it was taken: {call()}"
    except TelenanoError as error:
        return str(error)


def plan(scenario, site=None):
    return make_plan(UpRequest.model_validate({"scenario": scenario, "site": site}), Path(out) / "plan")


def run(*words):
    done = invoke(words)
    return [done.exit_code, " ".join(done.stdout.split()), " ".join(done.stderr.split())]


found = {
    "section": refusal(lambda: validate(AfmConfig, {"sample": {"particles": {}}}, "file", "afm_node")),
    "null": refusal(lambda: validate(AfmConfig, {"sample": {"flat": None}}, "file", "afm_node")),
    "begin": refusal(lambda: validate(AfmConfig, {"begin": {"program": "push", "push": {}}}, "file", "afm_node")),
    "program": refusal(lambda: validate(AfmConfig, {"begin": {"program": "push"}}, "file", "afm_node")),
    "set": refusal(lambda: requested({"program": "push", "push.x1_m": 1e-6})),
    "scenario": refusal(lambda: find_scenario("assembly")),
    "plan": refusal(lambda: plan(assembly)),
    "slave": refusal(lambda: plan(assembly, "slave")),
    "master": plan(assembly, "master").scenario.afm_node["sample"]["particles"]["count"],
    "command": "".join(run("assemble")[1:]),
}
found |= {
    "info": run("bag", "info", recording),
    "verify": run("bag", "verify", recording),
    "report": run("report", recording, "--out", out + "/report"),
    "export": run("bag", "export", recording, "--to", "mcap-json", "--out", out + "/plain.mcap"),
    "rerun": run("bag", "rerun", recording, "--node", "afm_node@slave"),
} if recording else {}
print(json.dumps(found))
"""


def said_without(folder: Path, recording: str) -> dict[str, Any]:
    """Return what is said where no package is installed, of a recording as well where one is given."""
    environment = {**os.environ, "TELENANO_WITHOUT_PACKAGES": "1", "COLUMNS": "500"}
    command = [sys.executable, "-c", PROGRAM, recording, str(folder), str(find_scenario("assembly"))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return said_without(tmp_path_factory.mktemp("refused"), "")


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what is said of a recording that was made with this package."""
    folder = tmp_path_factory.mktemp("particles")
    rig = VirtualRig(folder, 3, scenario=SCENARIO)
    rig.run_until(ARMED_S)
    rig.command("set", "afm_node", **PUSH)
    rig.command("start", "haptic_node")
    rig.run_until(0.9)
    return said_without(folder, str(rig.finish()))


@pytest.mark.parametrize(
    ("asked", "what"),
    [
        ("section", "afm_node.sample: the layer particles"),
        ("begin", "afm_node.begin: the program push"),
        ("program", "afm_node.begin.program: the program push"),
        ("set", "the program push"),
        ("scenario", "the scenario assembly"),
        ("plan", "the layer particles"),
        ("slave", "the layer particles"),
        ("command", "the command 'assemble'"),
    ],
)
def test_what_needs_the_package_names_it_in_one_sentence(found: dict[str, Any], asked: str, what: str) -> None:
    assert f"{what} {TOLD}" in " ".join(found[asked].split())
    assert "unknown key" not in found[asked]


def test_a_key_that_no_package_has_is_unknown_and_a_master_needs_no_package_of_the_slave(found: dict[str, Any]) -> None:
    assert "afm_node.sample.flat: unknown key" in found["null"]
    assert found["master"] == 8


@pytest.mark.check("compiles the steps of particles for a recording with them")
@pytest.mark.parametrize("command", ["info", "verify", "report", "export"])
def test_a_recording_with_particles_is_read(read: dict[str, Any], command: str) -> None:
    code, out, error = read[command]
    assert code == 0, error
    assert command in ("report", "export") or "afm/particles" in out or command == "verify"


@pytest.mark.check("compiles the steps of particles for a recording with them")
def test_a_re_run_of_the_instrument_names_the_package(read: dict[str, Any]) -> None:
    code, _, error = read["rerun"]
    assert code == 2
    told = f"the sample particles of {PACKAGE} 0.1.0, which is not installed here: {how_to_add_package(PACKAGE)}"
    assert told in error

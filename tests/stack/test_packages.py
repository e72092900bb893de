"""A law, device, operator and sample of packages that pip has installed: run, studied, recorded and run again."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from stack_rig import ROOT, Rig

from telenano.cli.new_package import new_package
from telenano.recording.reader import Recording

pytestmark = [pytest.mark.stack, pytest.mark.endurance]

NAMES = {"law": "filtered", "operator": "trembling", "sample": "layered", "device": "stub_handle"}


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The packages in a folder of their own, installed by pip: the environment of the tests stays as it is."""
    base = tmp_path_factory.mktemp("packages")
    for kind, name in NAMES.items():
        new_package(kind, name, base / name)
    quiet = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation")
    folders = [str(base / name) for name in NAMES.values()]
    command = [sys.executable, "-m", "pip", "install", *quiet, "--target", str(base / "site"), *folders]
    subprocess.run(command, check=True, timeout=300)
    return {**os.environ, "PYTHONPATH": os.pathsep.join((str(base / "site"), str(ROOT)))}


@pytest.fixture
def rig(environment: dict[str, str], rig: Rig) -> Rig:
    rig.environment = {**environment, "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    return rig


def telenano(environment: dict[str, str], *arguments: str) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "-m", "telenano", *arguments],
        env=environment, cwd=ROOT, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def result(environment: dict[str, str], *arguments: str) -> dict[str, Any]:
    code, out, err = telenano(environment, *arguments, "--json")
    assert code == 0, err
    found: dict[str, Any] = json.loads(out)
    return found


def test_the_law_is_listed_and_keeps_the_rules_compiled(environment: dict[str, str]) -> None:
    laws = {row["law"]: row for row in result(environment, "law", "list")["laws"]}
    assert (laws["filtered"]["package"], laws["filtered"]["version"]) == ("telenano-filtered", "0.1.0")
    assert laws["filtered"]["digest"].startswith("sha256:")
    assert result(environment, "law", "check", "filtered")["keeps_all"]


def test_law_and_sample_are_studied(environment: dict[str, str], tmp_path: Path) -> None:
    study = ("study", "stability", "--delay", "0:120:20", "--duration", "4", "--workers", "1")
    maps = result(environment, *study, "--law", "filtered", "--environment", "spring", "--stiffness", "10",
                  "--out", str(tmp_path / "spring"))  # fmt: skip
    critical_ms = maps["lines"][0]["critical_delay_ms"]
    # the loop of position_force bears 100 ms there; a filter of 5 ms takes some of it
    assert 80.0 < critical_ms < 100.0
    layered = result(environment, *study, "--law", "position_force", "--environment", "layered",
                     "--out", str(tmp_path / "layered"))  # fmt: skip
    assert layered["lines"][0]["environment"] == "layered"


@pytest.mark.parametrize(
    ("settings", "kinds"),
    [
        (("controller.law=filtered", "haptic_node.operator={kind: trembling}", "afm_node.environment=layered"),
         ("laws.filtered", "operators.trembling", "samples.layered")),
        (("haptic_node.driver=stub_handle",), ("devices.stub_handle",)),
    ],
)  # fmt: skip
def test_a_session_is_run_recorded_with_its_packages_and_run_again(
    rig: Rig, settings: tuple[str, ...], kinds: tuple[str, ...]
) -> None:
    summary = rig.run("--duration", "3", *(word for setting in settings for word in ("--set", setting)))
    assert set(summary["plugins"]) == set(kinds)
    for facts in summary["plugins"].values():
        assert facts["version"] == "0.1.0"
        assert facts["digest"].startswith("sha256:")
    recording = rig.out / "session.mcap"
    tip = [message.fields() for message in Recording(recording).messages(["afm/state"])]
    assert max(fields["tip_force_n"][2] for fields in tip) > 2e-9
    compared = result(rig.environment, "compare", str(recording), str(recording), "--out", str(rig.folder / "both"))
    assert [row["law"] for row in compared["sessions"]] == 2 * summary["law"]
    nodes = ("controller@master", "controller@slave", "haptic_node@master", "afm_node@slave")
    chosen = [word for node in nodes for word in ("--node", node)]
    found = result(rig.environment, "bag", "rerun", str(recording), *chosen)
    assert [row["identical"] for row in found["nodes"]] == [True] * len(nodes), found


def test_a_recording_says_which_package_is_missing_or_not_as_it_was(rig: Rig) -> None:
    rig.run("--duration", "3", "--set", "controller.law=filtered")
    recording = str(rig.out / "session.mcap")
    without = {**rig.environment, "PYTHONPATH": str(ROOT)}
    for words in (
        ("bag", "rerun", recording, "--node", "controller@master"),
        ("report", recording, "--out", str(rig.folder / "report")),
    ):
        code, _, err = telenano(without, *words)
        assert code == 2
        assert "the law filtered of telenano-filtered 0.1.0, which is not installed here" in err
    module = Path(rig.environment["PYTHONPATH"].split(os.pathsep)[0]) / "telenano_filtered" / "__init__.py"
    before = module.read_text()
    try:
        module.write_text(before.replace("default=0.005", "default=0.01"))
        code, out, _ = telenano(rig.environment, "bag", "rerun", recording, "--node", "controller@master")
    finally:
        module.write_text(before)
    assert code == 1
    assert "the law filtered of telenano-filtered was 0.1.0 with other files" in " ".join(out.split())

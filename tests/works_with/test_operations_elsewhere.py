"""What runs beside a rig: the page of metrics by Prometheus' own checker, the services by systemd's."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from foreign_programs import debian_program

from services.viz_node.metrics import NODE_METRICS, metrics_text
from telenano.signals import run
from telenano.timing.loop_age import Part

pytestmark = pytest.mark.timeout(1800)

DEPLOY = Path(__file__).parents[2] / "deploy"
SERVICES = sorted(path.name for path in DEPLOY.glob("*.service"))
REPORT = {metric.key: 1.5 for metric in NODE_METRICS} | {"state": "running", "beat": 0}


def check_metrics(text: str) -> "subprocess.CompletedProcess[str]":
    promtool = debian_program("usr/bin/promtool", "prometheus")
    return run([*promtool.command, "check", "metrics"], input=text, capture_output=True, text=True, check=False)


@pytest.mark.check("installs Prometheus")
def test_promtool_finds_nothing_in_the_page_of_metrics() -> None:
    text = metrics_text({"afm_node@slave": REPORT, 'a"\n\\b': REPORT}, 1, [Part("whole", 3e-3, 4e-3)])
    done = check_metrics(text)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert check_metrics(text.replace("overruns_total", "overruns")).returncode != 0


def found_by_systemd(folder: Path, name: str, text: str) -> str:
    """Return what systemd says of a service whose program is a file that this machine has."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    (folder / name).write_text(re.sub(r"(?m)^(ExecStart\w*)=\S+", r"\1=/bin/true", text))
    words = ["systemd-analyze", "verify", "--man=no", str(folder / name)]
    done = run(words, capture_output=True, text=True, check=False)
    return f"{done.stdout}{done.stderr}" or "failed" * (done.returncode != 0)


@pytest.mark.parametrize("name", SERVICES)
@pytest.mark.check("reads the units of the machine")
def test_systemd_finds_nothing_in_a_service(tmp_path: Path, name: str) -> None:
    text = (DEPLOY / name).read_text(encoding="utf-8")
    assert found_by_systemd(tmp_path, name, text) == ""
    assert "Restrat" in found_by_systemd(tmp_path, name, text.replace("Restart=", "Restrat="))

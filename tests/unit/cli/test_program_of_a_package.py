"""A new mode of the instrument is one file in a package outside the tree, and one row of entry points.

The circle of `telenano new program` is that package. What is asked of it comes from its settings alone: keys of `set`
and of a scenario, the form of the page, the command. It runs on the node's bench, behind the guard, in virtual time.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from test_package_commands import ROOT, put_on_path

from telenano.cli.new_package import new_package
from telenano.testing import said_with

ON_THE_BENCH = """
import json, math
import pytest
from telenano.testing import NodeBench as Bench
from test_afm_programs import Imager
from telenano.wire.errors import ConfigError, RefusedError
from telenano.sections.afm_section import AfmConfig
from telenano.console.send_commands import parse_parameters
from telenano.wire.node_state import pack, restore
from telenano.settings.config import validate
from services.viz_node.commander import forms

RIG = {"cantilever": {"stiffness_n_per_m": 1.0}}
ASKED = ["program=circle", "circle.radius_m=3e-8", "circle.speed_m_per_s=1e-7", "circle.approach_m_per_s=1e-6"]
found = {}

def refusal(afm, *pairs):
    try:
        return afm.set(**parse_parameters(pairs))
    except RefusedError as error:
        return str(error)

afm = Imager(Bench("afm_node@slave"), RIG)
found["answer"] = afm.set(**parse_parameters(ASKED))
found["second"] = refusal(afm, "program=scan")
found["pause"] = refusal(afm, "program=pause")
reports = lambda: [m for t, m in afm.bench.sent if t == "afm/program"]
afm.run(until=lambda: any(m.program == "circle" and m.done_percent > 50.0 for m in reports()))
state = pack(afm.node)
early = [m for t, m in afm.bench.sent if t == "afm/state"]

other = Imager(Bench("afm_node@slave"), RIG)
restore(other.node, state)
for each in (afm, other):
    each.bench.sent.clear()
    each.bench.clock = each.node.clock
    each.run()
ways = [[(m.base_position_m, m.tip_force_n) for m in each.bench.take("afm/state")] for each in (afm, other)]
found["restored"] = ways[0] == ways[1] and len(ways[0]) > 100
found["outcome"] = afm.outcome()
touching = [m for m in early if m.in_contact and m.mode == "follow" and m.tip_force_n[2] > 4.9e-9]
found["radii"] = [round(math.hypot(*m.base_position_m[:2]) * 1e9, 6) for m in touching]
found["forces"] = [m.tip_force_n[2] * 1e9 for m in touching[100:]]
found["turned"] = max(math.atan2(m.base_position_m[1], m.base_position_m[0]) for m in touching)

found["refused"] = [
    refusal(afm, "program=circle", "circle.radius_m=-1"),
    refusal(afm, "program=circle", "circle.gain_per_s=5000"),
    refusal(afm, "program=circle", "circle.size=2"),
    refusal(afm, "circle.radius_m=1e-8"),
    refusal(afm, "program=broken"),
]
begin = validate(AfmConfig, {"begin": {"program": "circle", "circle": {"turns": 2}}}, "s.yaml", "afm_node").begin
found["begin"] = [begin.program, begin.settings_of("circle").turns]
schema = forms()["afm_node"]
found["form"] = [schema["properties"]["circle"]["title"], sorted(schema["$defs"]["Settings"]["properties"])]
found["words"] = schema["properties"]["program"]["anyOf"][0]["enum"]
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    site = tmp_path_factory.mktemp("site")
    for name in ("circle", "broken"):
        new_package("program", name, site / name)
        put_on_path(site / name, site)
    (site / "broken" / "telenano_broken" / "__init__.py").write_text("BROKEN = 7\n")
    tests = ROOT / "tests" / "unit"
    folders = [site, site / "circle", site / "broken", ROOT, tests, tests / "afm"]
    paths = {"PYTHONPATH": os.pathsep.join(map(str, folders)), "XDG_CACHE_HOME": str(site / "cache")}
    document: dict[str, Any] = said_with(ON_THE_BENCH, site, **paths)
    return document


@pytest.mark.check("simulates a session")
def test_the_tip_goes_round_at_a_constant_force_and_retracts(found: dict[str, Any]) -> None:
    assert found["answer"] == "the tip goes round a circle of 3e-08 m at 5e-09 N"
    assert found["outcome"] == ["finished", "the circle is finished: the tip retracts"]
    assert len(found["radii"]) > 800
    assert found["radii"] == pytest.approx([30.0] * len(found["radii"]), abs=1e-3)
    assert found["forces"] == pytest.approx([5.0] * len(found["forces"]), rel=0.02)
    assert found["turned"] == pytest.approx(3.14, abs=0.05)


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_it_is_one_program_among_the_others(found: dict[str, Any]) -> None:
    assert found["second"] == "program: a circle is running; abort it first"
    assert found["pause"] == "program: a circle cannot pause, it can only be aborted"
    assert found["words"] == ["scan", "curve", "tactile", "circle", "push", "pause", "resume", "abort"]
    assert found["begin"] == ["circle", 2]


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_a_node_with_a_running_program_of_a_package_is_restored_and_goes_on(found: dict[str, Any]) -> None:
    assert found["restored"]


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_what_cannot_be_done_is_refused_by_its_key(found: dict[str, Any]) -> None:
    radius, gain, unknown, alone, broken = found["refused"]
    assert "afm_node.circle.radius_m: Input should be greater than or equal to" in radius
    assert "circle.gain_per_s = 5000 1/s makes the feedback unstable" in gain
    assert "circle.size: unknown key, known are radius_m" in unknown
    assert alone == "circle: takes effect with program=circle in the same command only"
    what = "broken of the package telenano-broken 0.1.0 cannot be used: TypeError: is a int, must be a Program"
    assert f"afm_node.program: {what}" in broken


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_the_form_of_the_page_has_its_settings(found: dict[str, Any]) -> None:
    title, keys = found["form"]
    assert title == "Circle"
    assert keys == ["approach_m_per_s", "gain_per_s", "radius_m", "setpoint_n", "speed_m_per_s", "turns", "x_m", "y_m"]


@pytest.mark.check("takes 2.5 s")
def test_the_package_passes_the_test_that_it_comes_with(tmp_path: Path) -> None:
    new_package("program", "my_round", tmp_path / "my_round")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path / "my_round"), str(ROOT)))}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    done = subprocess.run(command, cwd=tmp_path / "my_round", env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout

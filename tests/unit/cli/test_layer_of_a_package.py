"""A layer and a hand of a package outside the tree: those of docs/extending/surfaces.md, as they stand there."""

import re
from pathlib import Path
from typing import Any

import pytest
from test_package_commands import ROOT

from telenano.testing import describe_package, said_with

PAGE = (ROOT / "docs" / "extending" / "surfaces.md").read_text("utf-8")
BLOCKS = {
    "my_package": re.search(r"## My layer.*?```python\n(.*?)```", PAGE, re.DOTALL),
    "my_hand": re.search(r"## My hand across the sample.*?```python\n(.*?)```", PAGE, re.DOTALL),
}
ENTRY = re.search(r"## My layer.*?```toml\n(.*?)```", PAGE, re.DOTALL)

PROGRAM = """
import json, sys
import numpy as np
import yaml
from services.afm_node.node import AfmNode
from telenano.sections import AfmConfig
from telenano.devices.afm.instrument import driver_of, reach_of
from telenano.testing import NodeBench
from telenano.numerics.compiler import compiled_form
from telenano.settings import find_scenario, validate
from telenano.wire import ConfigError
from telenano.wire.node_state import pack, restore

LAYER = {"sample": {"name": "flat", "dust": {"height_m": 3.5e-9, "wear_per_s": 20.0}}}


def config(section, **more):
    return validate(AfmConfig, {**section, **more}, "a test", "afm_node")


def refusal(section, **more):
    try:
        config(section, **more)
    except ConfigError as error:
        return str(error)


def course(device, steps=200):
    found = []
    for _ in range(steps):
        device.elapse(1e-3)
        found.append(device.exchange(15e-9).force_n)
    return found


imported = lambda: "my_package" in sys.modules
found = {"imported": [imported()]}
bare = driver_of(config({"sample": {"name": "flat"}}))
found["imported"].append(imported())
dusty = config(LAYER)
found["imported"].append(imported())
device = driver_of(dusty)
for each in (bare, device):
    each.open()
found["truth"] = device.simulation.truths["dust"]
found["above"] = reach_of(dusty, device).above_m
found["force"] = [course(bare)[-1], *course(device)[::199]]
found["worn"] = device.simulation.truths["dust"]
device.restore_sample()
found["restored"] = device.simulation.truths["dust"]
found["refused"] = [
    refusal(LAYER, safety={"retract_position_m": -1e-9}),
    refusal(LAYER, environment="spring"),
    refusal({"sample": {"name": "flat", "dust": {"heigth_m": 1.0}}}),
    refusal({"sample": {"name": "flat", "rust": {}}}),
]
nodes = [AfmNode(NodeBench("afm_node@slave").context, dusty, driver_of(dusty)) for _ in range(2)]
for node in nodes[:1]:
    course(node._driver)
restore(nodes[1], pack(nodes[0]))
found["state"] = [node._driver.simulation.truths["dust"] for node in nodes]

import my_hand
from telenano import SimulatedSession

document = yaml.safe_load(find_scenario("fig12").read_text())
document["haptic_node"] = {**document["haptic_node"], "lateral": {}}
document["controller"] = {**document.get("controller", {}), "lateral": {"mode": "rate"}}
document |= {"duration_s": 1.0, "afm_node": {"sample": {"name": "flat", "dust": {}}}}
session = SimulatedSession.of(document, "my scenario", lambda period_s: my_hand.Circling(np.zeros(4)))
found["tip_y_m"] = [float(session["tip_y_m"][at]) for at in (0, -1)]
found["columns"] = [name for name in session.units if name.startswith("particle")]
if "--compiled" in sys.argv:
    again = SimulatedSession.of(
        document, "my scenario", lambda period_s: my_hand.Circling(np.zeros(4)), at_once=True
    )
    found["same"] = all(session[name].tobytes() == again[name].tobytes() for name in session.units)
print(json.dumps(found))
"""


def run(site: Path, *words: str) -> dict[str, Any]:
    assert ENTRY is not None
    group = re.search(r'"telenano.(.*?)"\]\n(\w+) = "(.*?)"', ENTRY[1])
    assert group is not None
    describe_package(site, "my_package", {group[1]: {group[2]: group[3]}})
    for name, block in BLOCKS.items():
        assert block is not None
        (site / f"{name}.py").write_text(block[1])
    document: dict[str, Any] = said_with(PROGRAM, site, *words, XDG_CACHE_HOME=str(site / "cache"))
    return document


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return run(tmp_path_factory.mktemp("package") / "site")


@pytest.mark.check("an interpreter of its own")
def test_the_package_is_imported_when_a_scenario_has_its_section(found: dict[str, Any]) -> None:
    assert found["imported"] == [False, False, True]


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_the_layer_holds_the_tip_up_and_keeps_a_state(found: dict[str, Any]) -> None:
    plain_n, first_n, last_n = found["force"]
    # the dust raises the surface by 3.5 nm, which a cantilever of 40 N/m feels as 140 nN or less
    assert plain_n + 5e-8 < first_n < plain_n + 1.4e-7
    # after 0.2 s in contact exp(-4) of it is left
    assert last_n == pytest.approx(plain_n, abs=0.04 * (first_n - plain_n))
    assert found["truth"] == found["restored"] == 3.5e-9
    assert found["worn"] == pytest.approx(3.5e-9 * 0.98**200, rel=0.03)
    assert found["above"] == 3.5e-9
    assert found["state"][0] == found["state"][1] < 3.5e-9


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_what_cannot_lie_there_is_refused_in_one_sentence(found: dict[str, Any]) -> None:
    height, environment, key, unknown = found["refused"]
    assert "safety.retract_position_m = -1e-09 m does not clear the dust: it must be -4e-09 m or less" in height
    assert "sample.dust: a layer is for driver simulated and environment tip_sample" in environment
    assert "afm_node.sample.dust.heigth_m: unknown key" in key
    assert "afm_node.sample.rust: unknown key" in unknown


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_a_hand_of_a_package_steers_the_tip_in_lockstep(found: dict[str, Any]) -> None:
    begin_m, end_m = found["tip_y_m"]
    assert begin_m == 0.0 != end_m
    assert found["columns"] == []


@pytest.mark.timeout(600)
@pytest.mark.endurance("compiles the loop over a layer of a package")
def test_a_session_with_both_gives_the_same_bits_compiled(tmp_path: Path) -> None:
    assert run(tmp_path / "site", "--compiled")["same"]

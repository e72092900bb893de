"""A simulated hand device of a package outside the tree: that of own-device.md, as it stands there."""

import re
from pathlib import Path

import pytest

from telenano.testing import install_package, said_with

PAGE = (Path(__file__).parents[3] / "packages/telenano-devices/docs/own-device.md").read_text("utf-8")
BLOCK = re.search(r"## My simulated hand device.*?```python\n(.*?)```", PAGE, re.DOTALL)
PROGRAM = """
import json, my_slide, telenano
from services.haptic_node.__main__ import build
from telenano.extend.hands import DriveCommand
from telenano.sections.hand_section import HapticConfig
from telenano.hand.part import initial_plant
from telenano.numerics.compiler import compiled_form
from telenano.testing import NodeBench

HAND = {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.1, "force_n": 1.0}]}
own = {"haptic_node.driver": "my_slide", "haptic_node.my_slide.time_constant_s": 0.001}
last = telenano.simulate("fig12", operator=HAND, duration_s=1.0, settings=own)
bench, config = NodeBench("haptic_node@master"), HapticConfig(driver="my_slide")
node = build(bench.context, config)
texts = [event.text for event in bench.take("session/event")]
params = config.to_simulated_params()
state = other = initial_plant(params, 0.0)
readings = []
for tick in range(200):
    inputs = DriveCommand(1, 1e-6 * tick, 0.0), 5e-3 * tick, 1e-3
    state, reading = compiled_form(my_slide.step)(params, state, *inputs)
    other, expected = my_slide.step(params, other, *inputs)
    readings.append(reading == expected)
ratio = last["operator_force_n"][-1] / (1e8 * last["tip_force_n"][-1])
print(json.dumps([float(ratio), texts, node.capture() is not None, all(readings)]))
"""


@pytest.mark.check("takes 2.8 s")
def test_it_runs_in_lockstep_on_its_node_and_compiled_alike(tmp_path: Path) -> None:
    assert BLOCK is not None
    install_package(tmp_path, "my_slide", {"__init__.py": BLOCK[1]}, {"devices": {"my_slide": "my_slide:MY_SLIDE"}})
    ratio, texts, runs_again, is_equal = said_with(PROGRAM, tmp_path)
    assert ratio == pytest.approx(1.05, rel=0.005, abs=0.0)
    assert "a slide: chosen, not measured" in texts and runs_again and is_equal

"""The wall clock of a machine is set by an hour or a second in mid-session: no node notices, because none asks it."""

import math
import re
import time
from pathlib import Path
from typing import Any

import pytest

from telenano.virtual import VirtualRig, constant_timing
from telenano.wire.codec import fields_of

ROOT = Path(__file__).parents[2]
HOUR_S = 3600.0
# 5.5 mm +- 3.5 mm once a second, as a person strokes a surface
SWING = [{"time_s": 0.05 * n, "position_m": 5.5e-3 - 3.5e-3 * math.cos(0.1 * math.pi * n)} for n in range(40)]
SCENARIO = {
    "name": "virtual",
    "description": "A hand swings while it presses the tip",
    "duration_s": 60.0,
    "haptic_node": {"operator": {"kind": "impedance", "path": SWING}},
    "afm_node": {"rest_distance_m": 10e-9},
    "delay_node": {way: {"delay_s": 0.005} for way in ("forward", "backward")},
}
# nothing late and nothing random, and the link a node of its own
TIMING = constant_timing(None, 100_000)
WALL_CLOCK = re.compile(r"\btime\.time(_ns)?\(|\bdatetime\.(now|today|utcnow)\(|\btime\.(local|gm)time\(\)")
# where a running process of the rig may ask the wall clock, and what it does with the answer
MAY_ASK = {
    "telenano/cli/commands/up.py": "the date in the name of the folder of a session",
    "telenano/analysis/kept_summary.py": "whether a source was edited after this process began",
    "telenano/analysis/page.py": "the date in the foot of a page",
    "telenano/testing/conformance/examination.py": "whether the clock of a client is that of this machine",
    "telenano/cli/commands/simulate.py": "the date in the name of the folder of a session",
    "telenano/virtual/simulate.py": "the date in the name of the folder of a session",
    "telenano/console/last_seen.py": "how long ago a person's device was last recorded",
    "telenano/timing/clock.py": "once, at the start of the first process, for the stamps of all",
    "telenano/launcher/rigs.py": "when a rig began, for a person who lists the rigs",
    "telenano/runtime/security/keyring.py": "the day on which a key expires",
    "telenano/numerics/digests.py": "when this process began, to compare with the times of its sources",
}


def tips_of(rig: VirtualRig, step_s: float, patch: pytest.MonkeyPatch) -> list[Any]:
    """Let the tip follow a hand, set the wall clock by a step [s], and return the states of the tip."""
    try:
        rig.run_until(0.15)
        rig.command("arm", "*", place="hand")
        rig.run_until(0.3)
        rig.command("start", "haptic_node@master")
        rig.run_until(0.6)
        if step_s:
            then_s = time.time() + step_s
            patch.setattr(time, "time", lambda: then_s)
            patch.setattr(time, "time_ns", lambda: round(then_s * 1e9))
        rig.run_until(1.1)
        return list(rig.received("afm/state", "afm_node@slave"))
    finally:
        rig.close()


@pytest.mark.check("takes 2.7 s")
@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S, 1.0, -1.0])
def test_a_step_of_the_wall_clock_changes_no_message_of_a_session(
    step_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = []
    for step in (0.0, step_s):
        with monkeypatch.context() as patch:
            tips = tips_of(VirtualRig(None, 1, (), TIMING, SCENARIO), step, patch)
        assert tips[-1].mode == "follow"
        sent.append([fields_of(tip) for tip in tips])
    assert sent[0] == sent[1]


def test_no_node_acts_on_the_wall_clock() -> None:
    found = {}
    for path in sorted(path for room in ("services", "telenano") for path in (ROOT / room).rglob("*.py")):
        lines = [line for line in path.read_text().splitlines() if WALL_CLOCK.search(line)]
        if lines:
            found[str(path.relative_to(ROOT))] = lines
    assert set(found) == set(MAY_ASK), found
    assert len(found["telenano/timing/clock.py"]) == 1

"""The wall clock of a machine is set by an hour or a second in mid-session: no node notices, because none asks it."""

import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_virtual_stalls import Session

from telenano.virtual import VirtualRig
from telenano.wire.codec import fields_of

ROOT = Path(__file__).parents[2]
HOUR_S = 3600.0
WALL_CLOCK = re.compile(r"\btime\.time(_ns)?\(|\bdatetime\.(now|today|utcnow)\(|\btime\.(local|gm)time\(\)")
# where a running process of the rig may ask the wall clock, and what it does with the answer
MAY_ASK = {
    "telenano/cli/commands/up.py": "the date in the name of the folder of a session",
    "telenano/analysis/kept_summary.py": "whether a source was edited after this process began",
    "telenano/analysis/page.py": "the date in the foot of a page",
    "telenano/testing/conformance/examination.py": "whether the clock of a client is that of this machine",
    "telenano/cli/commands/simulate.py": "the date in the name of the folder of a session",
    "telenano/timing/clock.py": "once, at the start of the first process, for the stamps of all",
    "telenano/launcher/rigs.py": "when a rig began, for a person who lists the rigs",
    "telenano/runtime/security/keyring.py": "the day on which a key expires",
    "telenano/numerics/digests.py": "when this process began, to compare with the times of its sources",
}


@pytest.fixture
def rigs() -> Iterator[list[VirtualRig]]:
    made: list[VirtualRig] = []
    yield made
    for rig in made:
        rig.close()


@pytest.mark.check("takes 2.7 s")
@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S, 1.0, -1.0])
def test_a_step_of_the_wall_clock_changes_no_message_of_a_session(
    step_s: float, rigs: list[VirtualRig], monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = []
    for steps in (False, True):
        session = Session("virtual_impedance", 5.0)
        rigs.append(session.rig)
        with monkeypatch.context() as patch:
            if steps:
                then_s = time.time() + step_s
                patch.setattr(time, "time", lambda then_s=then_s: then_s)
                patch.setattr(time, "time_ns", lambda then_s=then_s: round(then_s * 1e9))
            session.run(0.5)
        tips = session.tips()
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

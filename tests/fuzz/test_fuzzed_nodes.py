"""Nothing that arrives ends a node: every kind, fed with extreme and broken frames; and the messages that once did."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import fuzzed_nodes
import msgpack
import pytest
from tried_laws import TRIED_LAWS as LAWS

from telenano.testing.filled_messages import examples
from telenano.testing.frames import Frames, stream
from telenano.wire import encode
from telenano.wire.codec import accept
from telenano.wire.sequence import MOST_COUNTED
from telenano.wire.topics import OWN_TOPICS as TOPICS

ROOT = Path(__file__).parents[2]
COUNT = 150


@pytest.fixture(scope="module")
def results() -> dict[str, dict[str, Any]]:
    command = [sys.executable, str(Path(fuzzed_nodes.__file__)), "short", str(COUNT)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "contract")))}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    found: dict[str, dict[str, Any]] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("name", fuzzed_nodes.BUILD)
def test_nothing_that_arrives_ends_a_node(results: dict[str, dict[str, Any]], name: str) -> None:
    result = results[name]
    assert result["ended"] == ""
    # it did take what the schemas allow, and refuse what they do not
    assert result["received"] > 0.6 * COUNT, result
    assert sum(result["refused"].values()) > 0.6 * COUNT, result
    assert result["published"] > 0


def test_a_node_that_ends_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fragile(*given: Any) -> Any:
        node = build(*given)
        node.on_message = lambda received: 1 / 0
        return node

    build = fuzzed_nodes.BUILD["launcher@master"]
    monkeypatch.setitem(fuzzed_nodes.BUILD, "launcher@master", fragile)
    assert "ZeroDivisionError" in fuzzed_nodes.fuzz("launcher@master", "short", 20, tmp_path)["ended"]


def test_the_same_seed_gives_the_same_frames_and_the_extreme_ones_are_accepted() -> None:
    topics = list(TOPICS)
    first, second = (list(stream(Frames("seed", 10**18), topics, 3 * len(topics))) for _ in range(2))
    assert first == second
    assert first != list(stream(Frames("other", 10**18), topics, 3 * len(topics)))
    for topic, payload in first[::2]:
        assert accept(topic.decode(), payload).t_ns >= 0


def _frames(topic: str, **changes: Any) -> list[bytes]:
    fields = msgpack.unpackb(encode(examples(TOPICS[topic])["ordinary"]))
    return [topic.encode(), msgpack.packb({**fields, **changes})]


# topic, field and value of the one valid message that ended a controller, by its half
ENDED = [
    ("controller@master", "haptic/state", "operator_force_n", 1e200),
    ("controller@master", "teleop/backward", "force_n", 1e308),
    ("controller@slave", "afm/state", "base_position_m", 1e308),
    ("controller@slave", "afm/state", "tip_force_n", 1e308),
]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("key", "topic", "field", "value"), ENDED)
def test_one_valid_message_no_longer_ends_a_controller(
    law: str, key: str, topic: str, field: str, value: float, node_on_bus: Any
) -> None:
    bus, loop = node_on_bus(f"{key} {law}")
    master = key.endswith("@master")
    signal = "teleop/backward" if master else "teleop/forward"
    device = "haptic/state" if master else "afm/state"
    usual = {"hand_t_ns": 0, "law": law, "active": True, "position_m": [0.0, 0.0, -1e-9], "force_n": [0.0, 0.0, 1e-9]}
    for seq in range(6):
        stamp = fuzzed_nodes.EPOCH_NS + 10**9 + seq * 10**6
        mode = {"mode": "position" if master else "follow"}
        bus.take(_frames(device, seq=2 * seq, t_ns=stamp, **mode))
        bus.take(_frames(signal, seq=2 * seq, t_ns=stamp, **{**usual, "hand_t_ns": stamp}))
        wrong = {"law": law, "active": True} if topic == signal else mode
        bus.take(_frames(topic, seq=2 * seq + 1, t_ns=stamp, **wrong, **{field: [0.0, 0.0, value]}))
        loop.turn()
        bus.clock.advance_ns(10**6)
    # refused, and the half went on with what else came
    assert bus.rejections()[0] == {"range": 6}
    assert bus.published >= 6


@pytest.mark.unchecked("its numbers and answers are made up")
def test_six_frames_with_made_up_numbers_no_longer_end_the_recorder(node_on_bus: Any) -> None:
    bus, loop = node_on_bus("recorder@master")
    for source in ("a@slave", "b@slave", "c@slave"):
        for seq in (0, 2**63 - 1):
            bus.take(_frames("session/event", seq=seq, t_ns=seq, src=source))
    loop.node.clock.advance_ns(10**9)
    loop.turn()
    loop.node.make_safe()
    assert loop.node._intake.lost == MOST_COUNTED
    assert not loop.node._intake.fault


def test_a_count_of_a_peer_that_makes_up_numbers_is_reported_as_the_greatest(node_on_bus: Any) -> None:
    bus, loop = node_on_bus("haptic_node@master")
    for number in range(4):
        for seq in (0, 2**63 - 1):
            bus.take(_frames("haptic/command", seq=seq, t_ns=2 * number + (seq > 0), src="a@master"))
    (row,) = [row for row in bus.input_health() if row.src == "a@master"]
    assert row.lost == MOST_COUNTED
    loop.publish_health()

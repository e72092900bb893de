"""What pages are told, from golden messages of the wire."""

import json
import math
import random
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from services.viz_node.feed import Feed, SeenMessage
from services.viz_node.source import TOPICS_SHOWN
from services.viz_node.streams import STREAMS, described

VECTORS = json.loads((Path(__file__).parents[3] / "proto" / "golden" / "vectors.json").read_text())
START_NS = 10**18
WAYS = ("forward", "backward")


def golden(topic: str, case: str = "ordinary") -> dict[str, Any]:
    payload = next(v["hex"] for v in VECTORS if v["topic"] == topic and v["case"] == case)
    fields: dict[str, Any] = msgpack.unpackb(bytes.fromhex(payload))
    return fields


def seen(topic: str, src: str, t_ns: int = START_NS, **changes: Any) -> SeenMessage:
    return SeenMessage(topic, src, t_ns, {**golden(topic), **changes})


def columns(taken: dict[str, Any], name: str) -> dict[str, Any]:
    stream = next(stream for stream in STREAMS if stream.name == name)
    data = taken["streams"][name]
    table = np.frombuffer(data["data"], dtype="<f4").reshape(-1, data["n"])
    return dict(zip(["time", *(column.name for column in stream.columns)], table, strict=True))


@pytest.mark.parametrize("topic", TOPICS_SHOWN)
@pytest.mark.parametrize("case", ["minimal", "ordinary", "nil"])
def test_every_golden_message_of_a_shown_topic_is_understood(topic: str, case: str) -> None:
    feed = Feed()
    fields = golden(topic, case)
    for site in ("master", "slave"):
        feed.record(SeenMessage(topic, f"node@{site}", START_NS, fields))
    assert feed.left_out.rejected == {}
    assert feed.take()
    assert feed.take() == {}
    # what a page is sent is msgpack
    msgpack.packb(feed.snapshot())


def test_a_curve_has_the_paper_s_axis_and_the_time_of_its_publisher() -> None:
    feed = Feed()
    for i in range(3):
        position, force = (0.0, 0.0, -1e-3 * i), (0.0, 0.0, -2.0)
        changes = {"position_m": position, "operator_force_n": force, "answered_t_ns": 0}
        feed.record(seen("haptic/state", "haptic_node@master", START_NS + i * 1_000_000, **changes))
    hand = columns(feed.take(), "hand")
    np.testing.assert_allclose(hand["time"], [0.0, 1e-3, 2e-3], rtol=1e-6, atol=0)
    np.testing.assert_allclose(hand["position"], [0.0, 1e-3, 2e-3], rtol=1e-6, atol=0)
    assert set(hand["force"]) == {2.0}
    # no command has been answered: the age of the loop is not known
    assert np.isnan(hand["loop_age"]).all()
    feed.record(seen("haptic/state", "haptic_node@master", START_NS + 9_000_000, coupling_energy_j=2e-3))
    coupled = columns(feed.take(), "hand")
    np.testing.assert_allclose(coupled["coupling_energy"], [2e-3], rtol=1e-6, atol=0)
    # a device without a coupling says nothing of it
    feed.record(seen("haptic/state", "haptic_node@master", START_NS + 10_000_000, coupling_energy_j=None))
    assert np.isnan(columns(feed.take(), "hand")["coupling_energy"]).all()


def test_the_clock_of_the_slave_is_put_right_by_what_the_link_measures() -> None:
    feed = Feed()
    clock = {"valid": True, "offset_s": 2.0, "uncertainty_s": 1e-3, "round_trip_s": 2e-3, "exchanges": 9}
    feed.record(seen("link/status", "delay_node@master", clock=clock))
    feed.record(seen("afm/state", "afm_node@slave", START_NS + 2_000_000_000))
    assert feed.take()["streams"]["tip"]["t0"] == pytest.approx(0.0, abs=1e-9)


def test_the_loss_of_the_link_is_the_share_dropped_since_the_report_before() -> None:
    feed = Feed()
    # the last report is of a link that was started anew
    for i, (came, dropped) in enumerate([(1000, 5), (1200, 55), (1200, 55), (1300, 255), (10, 0)]):
        ways = {way: {**golden("link/status")[way], "messages_in": came, "dropped": {"loss": dropped}} for way in WAYS}
        feed.record(seen("link/status", "delay_node@master", START_NS + i, **ways))
    link = columns(feed.take(), "link")
    for way in WAYS:
        np.testing.assert_allclose(link[f"{way}_loss"], [np.nan, 0.25, np.nan, 1.0, np.nan], rtol=1e-6, atol=0)


def test_only_what_changed_is_told_again() -> None:
    feed = Feed()
    feed.record(seen("afm/state", "afm_node@slave", mode="follow"))
    first = feed.take()
    assert first["state"]["afm/state/slave"]["mode"] == "follow"
    # a page that came before anything was said learns when the times of the curves begin
    assert first["origin_ns"] == feed.snapshot()["origin_ns"] == START_NS
    feed.record(seen("afm/state", "afm_node@slave", mode="follow"))
    assert not {"state", "origin_ns"} & feed.take().keys()
    feed.record(seen("afm/state", "afm_node@slave", mode="estop"))
    assert feed.take()["state"]["afm/state/slave"]["mode"] == "estop"
    assert feed.snapshot()["state"]["afm/state/slave"]["mode"] == "estop"


def test_after_a_stall_the_newest_samples_are_left() -> None:
    feed = Feed()
    for i in range(2500):
        feed.record(seen("haptic/command", "controller@master", START_NS + i * 1_000_000))
    command = feed.take()["streams"]["command"]
    assert command["n"] == 1000
    assert command["t0"] == pytest.approx(1.5)


def test_the_health_of_a_node_is_shown_however_much_its_counts_have_reached() -> None:
    feed = Feed()
    health = golden("node/health")
    row = {**health["inputs"][0], "lost": 2**63 - 1}
    feed.record(seen("node/health", "afm_node@slave", inputs=[row] * 3, rejected={"a": 2**63 - 1, "b": 2**63 - 1}))
    node = feed.take()["nodes"]["afm_node@slave"]
    assert (node["lost"], node["rejected"]) == (2**63 - 1, 2**63 - 1)
    assert feed.left_out.rejected == {}


def test_a_node_that_has_ended_is_shown_as_ended() -> None:
    feed = Feed()
    feed.record(seen("node/health", "afm_node@slave"))
    end = {"kind": "node", "data": {"state": "ended", "sent.afm/state": 7}}
    feed.record(seen("session/event", "afm_node@slave", **end))
    assert feed.take()["nodes"]["afm_node@slave"]["state"] == "ended"


def test_lines_of_an_image_are_kept_for_a_page_that_comes_later_until_another_image_begins() -> None:
    feed = Feed()
    for line in (0, 1, 2):
        feed.record(seen("afm/scanline", "afm_node@slave", line=line, lines=3, direction="trace"))
    assert [line["line"] for line in feed.take()["lines"]] == [0, 1, 2]
    assert [line["line"] for line in feed.snapshot()["lines"]] == [0, 1, 2]
    feed.record(seen("afm/scanline", "afm_node@slave", line=0, lines=3, direction="trace"))
    assert [line["line"] for line in feed.snapshot()["lines"]] == [0]


@pytest.mark.parametrize("fields", [{}, {"position_m": 1}, {"position_m": [1.0]}, {"inputs": None}])
@pytest.mark.parametrize("topic", TOPICS_SHOWN)
def test_a_message_that_is_none_is_counted_and_stops_nothing(topic: str, fields: dict[str, Any]) -> None:
    feed = Feed()
    feed.record(
        SeenMessage(topic, "haptic_node@master" if topic.startswith("haptic") else "afm_node@slave", START_NS, fields)
    )
    assert feed.left_out.rejected == {"unreadable": 1} or topic == "haptic/command"


def test_the_page_is_told_names_and_units_in_the_order_of_the_columns() -> None:
    for stream, about in zip(STREAMS, described(), strict=True):
        assert [column["name"] for column in about["columns"]] == [column.name for column in stream.columns]
        assert all(column["unit"] and column["about"] for column in about["columns"])


_EXTREMES: tuple[Any, ...] = (
    math.inf, -math.inf, math.nan, 1e300, -1e308, 1e308, 2**64 - 1, -(2**63), 2**62, 0, -1, "", "x" * 100_000,
    b"\xff", None, True, [], {}, [math.inf] * 3, {"valid": True, "offset_s": 1e308, "uncertainty_s": 0.0},
    msgpack.Timestamp(1), [[[[[[[[]]]]]]]],
)  # fmt: skip


def deep(levels: int = 500) -> Any:
    """Return a list in a list, almost as deep as msgpack goes."""
    found: Any = []
    for _ in range(levels):
        found = [found]
    return found


def mutated(fields: Any, draw: random.Random) -> Any:
    """Return a message with one value, at any depth, that nobody would send in earnest."""
    keys = list(fields) if isinstance(fields, dict) else list(range(len(fields))) if isinstance(fields, list) else []
    if not keys or draw.random() < 0.3:
        return draw.choice([*_EXTREMES, deep()])
    key = draw.choice(keys)
    if isinstance(fields, dict):
        return {**fields, key: mutated(fields[key], draw)}
    return [*fields[:key], mutated(fields[key], draw), *fields[key + 1 :]]


@pytest.mark.parametrize("seed", range(4))
def test_no_value_of_a_frame_ends_what_makes_the_pages_frames(seed: int) -> None:
    draw = random.Random(seed)
    feed = Feed()
    taken = []
    for i in range(1500):
        topic = draw.choice(TOPICS_SHOWN)
        site = draw.choice(("master", "slave"))
        fields = golden(topic, draw.choice(("minimal", "ordinary", "nil")))
        changed = mutated(fields, draw)
        time_ns = draw.choice([START_NS + i, START_NS + i, *(e for e in _EXTREMES if isinstance(e, int))])
        src = draw.choice((f"node@{site}", f"node@{site}", "x" * 70_000, f"n@{i}"))
        feed.record(SeenMessage(topic, src, time_ns, changed))
        if i % 10 == 0:
            taken.append(msgpack.packb({"k": "tick", **feed.take()}))
            msgpack.packb({"k": "snapshot", "streams": described(), **feed.snapshot()})
    assert feed.left_out.rejected["unreadable"] > 100
    # what is as it should be is shown as before
    feed.record(seen("afm/state", "afm_node@slave", START_NS, mode="follow"))
    assert feed.snapshot()["state"]["afm/state/slave"]["mode"] == "follow"
    assert max(map(len, taken)) < 1 << 20


@pytest.mark.parametrize("t_ns", [math.inf, math.nan, 1e300, 2**64 - 1, -(2**63), "now", None])
def test_a_time_that_is_none_is_left_out(t_ns: Any) -> None:
    feed = Feed()
    feed.record(seen("haptic/state", "haptic_node@master", t_ns))
    assert (feed.left_out.rejected, feed.take()) == ({"unreadable": 1}, {})


@pytest.mark.parametrize(
    ("topic", "src", "changes"),
    [
        ("link/status", "delay_node@master", {"clock": {"valid": True, "offset_s": 1e308, "uncertainty_s": 0.0}}),
        ("link/status", "delay_node@master", {"clock": {"valid": True, "offset_s": 1e200, "uncertainty_s": 0.0}}),
        ("afm/scanline", "afm_node@slave", {"line": math.inf}),
        ("node/health", "afm_node@slave", {"rejected": {"a": 2**64 - 1, "b": 2**64 - 1}}),
        ("node/health", "afm_node@slave", {"state": deep()}),
        ("afm/state", "afm_node@slave", {"base_position_m": [1e300, math.inf, -math.inf]}),
        ("session/event", "afm_node@slave", {"text": "x" * 100_000}),
    ],
)
def test_a_value_beyond_every_range_ends_nothing(topic: str, src: str, changes: dict[str, Any]) -> None:
    feed = Feed()
    feed.record(seen(topic, src, **changes))
    feed.record(seen("afm/state", "afm_node@slave"))
    assert len(msgpack.packb(feed.take())) < 1 << 16
    assert len(msgpack.packb(feed.snapshot())) < 1 << 16


def test_lines_of_an_image_are_kept_as_far_as_they_have_room() -> None:
    feed = Feed()
    heights = {**golden("afm/scanline")["height_m"], "data": bytes(1_000_000)}
    for line in range(100):
        feed.record(seen("afm/scanline", "afm_node@slave", line=line, lines=100, height_m=heights))
    assert len(feed.snapshot()["lines"]) == 67
    feed.record(seen("afm/scanline", "afm_node@slave", line=0, height_m={**heights, "data": bytes(2_000_000)}))
    assert feed.left_out.rejected == {"unreadable": 1}


def test_the_queue_of_a_line_is_a_fact_of_its_direction_and_an_earlier_end_has_none() -> None:
    feed = Feed()
    line = {"direction": "forward", "queue_s": 0.0524, "capacity_bit_per_s": 10**6, "line": "full"}
    feed.record(seen("link/network", "controller@slave", **line))
    feed.record(seen("link/network", "delay_node@master", START_NS + 1, direction="backward"))
    assert feed.snapshot()["state"] == {
        "line/forward": {"queue_s": 0.052, "capacity_bit_per_s": 10**6, "sends": "full", "blocked_since_ns": None},
        "line/backward": {"queue_s": None, "capacity_bit_per_s": None, "sends": None, "blocked_since_ns": None},
    }
    assert feed.left_out.rejected == {}


@pytest.mark.parametrize(
    ("data", "advises"),
    [
        ({"advice": True, "law": "wave", "outside": "line"}, "wave"),
        ({"advice": True}, ""),
        ({"law": "wave"}, None),
        # a word of another node that only looks like it
        ({"advice": 1, "law": "wave"}, None),
    ],
)
def test_what_an_adviser_said_is_told_with_its_law_and_no_other_event_is(
    data: dict[str, Any], advises: str | None
) -> None:
    feed = Feed()
    feed.record(
        seen("session/event", "launcher@master", kind="node", level="warning", text="the line is long", data=data)
    )
    (event,) = feed.take()["events"]
    assert event.get("advises") == advises


@pytest.mark.parametrize(
    ("mode", "placed", "follows"),
    [
        ("follow", True, 1.0),
        ("hold", True, 1.0),
        # a recording of before does not say whether the tip is placed
        ("follow", None, 1.0),
        ("follow", False, 0.0),
        ("retracting", True, 0.0),
        ("retracted", True, 0.0),
        ("estop", True, 0.0),
    ],
)
def test_a_tip_that_is_placed_or_withdrawn_does_not_follow(mode: str, placed: bool | None, follows: float) -> None:
    feed = Feed()
    feed.record(seen("afm/state", "afm_node@slave", mode=mode, placed=placed))
    assert columns(feed.take(), "tip")["follows"].tolist() == [follows]


def test_the_limit_of_a_guard_comes_with_the_node_that_has_one_and_with_no_other() -> None:
    feed = Feed()
    for src, limit_n in (("afm_node@slave", 1.5e-7), ("haptic_node@master", None)):
        feed.record(seen("node/health", src, force_limit_n=limit_n))
    nodes = feed.take()["nodes"]
    assert nodes["afm_node@slave"]["force_limit_n"] == 1.5e-7
    assert "force_limit_n" not in nodes["haptic_node@master"]
    # A report that was recorded before the key was there has none.
    old = {key: value for key, value in golden("node/health").items() if key != "force_limit_n"}
    feed.record(SeenMessage("node/health", "afm_node@slave", START_NS, old))
    assert "force_limit_n" not in feed.take()["nodes"]["afm_node@slave"]

"""Any node of the rig, under any law, is re-run bit by bit by its journal, and what was changed is found."""

from collections import Counter
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest
from in_memory import InMemory
from references import REFERENCED as LAWS
from references import REFERENCES

from telenano.recording.channel_filter import Selection
from telenano.recording.messages import RecordedMessage
from telenano.recording.reader import RawMessage, Recording
from telenano.recording.records import GAP_TOPIC
from telenano.recording.rewrite import filter_recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.rerun import rerun as rerun_module
from telenano.rerun.rerun import RerunResult, rerun
from telenano.runtime.loop.journal import DEFERRED
from telenano.virtual import LINK_NODE, NODES, VirtualRig, record_session
from telenano.wire.codec import fields_of
from telenano.wire.errors import ConfigError, RecordingError
from telenano.wire.messages import Array, LinkFates
from telenano.wire.nodes import LINK, name_of, site_of

FORWARDED = {
    "teleop/forward@slave", "session/control@slave", "teleop/backward@master", "law/status@master",
    "session/event@master", "node/health@master",
}  # fmt: skip
COMPARED = {
    LINK_NODE: {"link/fates", "link/status", "link/delay", "link/delay@slave", "clock/ping"} | FORWARDED,
    "controller@master": {"teleop/forward", "haptic/command", "law/status"},
    "controller@slave": {"afm/command", "teleop/backward", "law/status"},
    "afm_node@slave": {"afm/state", "clock/pong"},
    "haptic_node@master": {"haptic/state"},
}


@pytest.fixture(scope="module")
def sessions(reference_of: Callable[[str], Path]) -> Callable[[str], Recording]:
    """The session of each reference, read once."""
    return cache(lambda name: InMemory(reference_of(name)))


@pytest.fixture(scope="module")
def ends(sessions: Callable[[str], Recording], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """The same, cut off while the tip is pressed down."""
    folder = tmp_path_factory.mktemp("ends")
    for law in LAWS:
        filter_recording(sessions(law).path, folder / f"{law}.mcap", start_s=0.6)
    return {law: InMemory(folder / f"{law}.mcap") for law in LAWS}


def edited(recording: Recording, folder: Path, edit: Callable[[RawMessage], bytes | None]) -> Path:
    """Copy a recording; `edit` gives the payload of a message, None to leave it out."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    for name, found in recording.attachment_records.items():
        writer.attach(name, found.media_type, found.data, found.log_time)
    channels: dict[Any, int] = {}
    for message in recording.raw():
        payload = edit(message)
        if payload is None:
            continue
        facts = dict(message.channel.metadata)
        if facts["topic"] == GAP_TOPIC:
            # The writer of the copy has gaps of its own.
            continue
        place = (facts["topic"], facts["src"], facts["site"])
        if place not in channels:
            channels[place] = writer.channel(*place)
        writer.write(channels[place], message.log_ns, message.publish_ns, message.seq, payload)
    writer.finish()
    return writer.path


@pytest.mark.check("takes 3.5 s")
@pytest.mark.parametrize("node", (LINK_NODE, *NODES))
@pytest.mark.parametrize("name", REFERENCES)
def test_a_rerun_gives_the_same_bits(sessions: Callable[[str], Recording], name: str, node: str) -> None:
    recording = sessions(name)
    result = rerun(recording, node)
    assert result.difference == ""
    assert result.identical, result.verdict()
    assert result.left_out == 0
    assert set(result.compared) == COMPARED[node]
    recorded = Counter(name_of_output(found, node) for found in recording.messages() if is_output(found, node))
    damaged = Counter(found.fields()["frames"][0].decode() for found in recording.messages(["recorder/rejected"]))
    for topic, count in result.compared.items():
        own = "@" not in topic
        assert count == recorded[topic] + (0 if own else damaged[topic.partition("@")[0]])
        assert count > LEAST.get(topic, 50 if "law" in topic else 400)
        if own:
            assert result.first_seq[topic] == 0


# on the bus of a rig that runs for one and a half seconds
LEAST = {
    "clock/ping": 10, "clock/pong": 10, "link/status": 10, "link/fates": 50, "link/delay": 10, "link/delay@slave": 10,
    "session/control@slave": 1, "session/event@master": 1, "node/health@master": 2,
}  # fmt: skip


def is_output(found: RecordedMessage, node: str) -> bool:
    """Return whether a message is one of a node, or one that the link sent on."""
    if node != LINK_NODE:
        return found.via == "direct" and found.src == node
    return found.via == "link" or name_of(found.src) == LINK


def name_of_output(found: RecordedMessage, node: str) -> str:
    """Return the name by which a re-run counts an output: what the link says at both sites has that of the other."""
    elsewhere = found.topic == "link/delay" and found.src != node
    return f"{found.topic}@{site_of(found.src)}" if elsewhere else found.channel_topic


@pytest.mark.parametrize("name", REFERENCES)
def test_the_link_does_what_its_settings_say(sessions: Callable[[str], Recording], name: str) -> None:
    """Without it a re-run of the link would show nothing."""
    messages = [found.decode() for found in sessions(name).messages(["link/fates"])]
    fates = [fate for message in messages if isinstance(message, LinkFates) for fate in message.fates]
    delays = {fate.delay_ns for fate in fates if not fate.dropped}
    done = {
        "virtual_impedance": delays == {3_000_000},
        "position_force": any(fate.reordered for fate in fates) and any(fate.is_duplicate for fate in fates),
        "wave": {fate.dropped for fate in fates} == {"", "loss", "gilbert_elliott"},
        "smith": any(fate.queue_ns > 1_000_000 for fate in fates) and any(fate.dropped == "queue" for fate in fates),
        "passivity": any(fate.reordered for fate in fates) and any(fate.corrupted for fate in fates),
        "model_mediated": any(fate.held_ns > 0 for fate in fates) and len(delays) > 100,
        "link": {fate.dropped for fate in fates} >= {"", "loss", "gilbert_elliott"}
        and all(any(getattr(fate, what) for fate in fates) for what in ("is_duplicate", "reordered", "corrupted"))
        and any(fate.queue_ns for fate in fates)
        and len(delays) > 1000,
    }
    assert done[name]


def test_the_hand_touches_the_sample(sessions: Callable[[str], Recording]) -> None:
    """Without it nothing of a law would be seen."""
    for law in LAWS:
        states = [found.fields() for found in sessions(law).messages(["afm/state"])]
        assert {state["mode"] for state in states} >= {"retracted", "follow"}, law
        assert any(state["in_contact"] for state in states), law


@pytest.mark.check("takes 0.9 s")
@pytest.mark.parametrize("node", (LINK_NODE, *NODES))
def test_a_rerun_begins_in_the_middle(ends: dict[str, Recording], node: str) -> None:
    """The state in the journal is all that a node needs: here it begins while the tip is pressed down."""
    for law, recording in ends.items():
        result = rerun(recording, node)
        assert result.identical, f"{law}: {result.verdict()}"
        fast = [topic for topic in result.first_seq if topic not in LEAST or topic == "link/fates"]
        assert min(result.first_seq[topic] for topic in fast if "law" not in topic) > 30
        assert result.left_out > 0
        assert sum(result.compared.values()) > 400


@pytest.mark.check("takes 2.6 s")
def test_a_changed_law_is_rerun(tmp_path: Path) -> None:
    rig = VirtualRig(tmp_path, seed=3)
    rig.run_until(0.15)
    rig.command("arm", "*", place="hand")
    for time_s, law in ((0.3, "wave"), (0.6, "smith")):
        rig.run_until(time_s)
        rig.command("set", "controller", law=law)
        rig.command("set", "delay_node", **{"backward.jitter.scale_s": 0.001 * time_s, "forward.loss.probability": 0.1})
    rig.run_until(1.2)
    path = rig.finish()
    late = tmp_path / "late.mcap"
    filter_recording(path, late, start_s=0.4)
    # the law that was in force when the second one begins is in the state
    for recording in (InMemory(path), InMemory(late)):
        results = [rerun(recording, node) for node in (LINK_NODE, *NODES)]
        assert all(result.identical for result in results), [result.verdict() for result in results]


@pytest.mark.check("takes 1.4 s")
def test_the_deadband_and_its_statistics_are_rerun(tmp_path: Path) -> None:
    path = record_session(tmp_path, 5, ["controller.deadband.enabled=true"], duration_s=1.0)
    recording = InMemory(path)
    results = [rerun(recording, node) for node in NODES]
    assert all(result.identical for result in results), [result.verdict() for result in results]


@pytest.mark.check("takes 8.5 s")
def test_the_motion_of_a_cantilever_between_commands_is_rerun_over_batches_of_the_journal(tmp_path: Path) -> None:
    path = record_session(tmp_path, 5, ["afm_node.model=dynamic"], duration_s=1.3)
    recording = InMemory(path)
    journals: list[Any] = [
        found.decode() for found in recording.messages(["node/journal"]) if found.src == "afm_node@slave"
    ]
    tasks = sum(int((journal.kind.to_numpy() == DEFERRED).sum()) for journal in journals)
    assert (len(journals) >= 3, tasks > 500) == (True, True)
    result = rerun(recording, "afm_node@slave")
    assert result.identical, result.verdict()
    assert result.compared["afm/state"] > 500


def test_a_changed_gain_is_found(sessions: Callable[[str], Recording]) -> None:
    recording = sessions("virtual_impedance")
    result = rerun(recording, "controller@master", settings=["controller.virtual_impedance.force_gain=10.0000001"])
    assert not result.identical
    assert (result.topic, result.field) == ("haptic/command", "position_m.2")
    assert f"haptic/command, seq {result.seq}, {result.time_s:.6f} s after the start: re-run" in result.difference


def swapped(message: RawMessage, topics: tuple[str, str]) -> bytes:
    """Swap neighbouring turns of a journal, each at the time of its place; a deadline has no topic.

    All neighbours of that order: the swap of two changes nothing where the first did not act on the second.
    """
    fields = msgpack.unpackb(message.payload)
    places = {source["topic"]: place for place, source in enumerate(fields["inputs"])} | {"": -1}
    kinds = tuple(places[topic] for topic in topics)
    arrays = {name: msgspec.convert(fields[name] | {"shape": tuple(fields[name]["shape"])}, Array) for name in FIELDS}
    columns = {name: found.to_numpy().copy() for name, found in arrays.items()}
    inputs = columns["input"].tolist()
    for place in (n for n, pair in enumerate(pairwise(inputs)) if pair == kinds):
        for name in ("kind", "input", "number"):
            columns[name][[place, place + 1]] = columns[name][[place + 1, place]]
    return bytes(msgpack.packb(fields | {name: fields_of(Array.from_numpy(columns[name])) for name in FIELDS}))


FIELDS = ("kind", "time_ns", "input", "number")
NEIGHBOURS = {
    "controller@slave": ("teleop/forward", "afm/state"),
    "controller@master": ("haptic/state", "teleop/backward"),
    "haptic_node@master": ("", "haptic/command"),
}


@pytest.mark.parametrize("node", NEIGHBOURS)
def test_a_swapped_order_is_found(sessions: Callable[[str], Recording], tmp_path: Path, node: str) -> None:
    seen: list[int] = []

    def edit(message: RawMessage) -> bytes:
        if message.channel.topic == "node/journal" and message.channel.src == node:
            seen.append(1)
            if len(seen) == 2:
                return swapped(message, NEIGHBOURS[node])
        return message.payload

    result = rerun(Recording(edited(sessions("virtual_impedance"), tmp_path, edit)), node)
    assert result.difference != ""
    assert "after the start: " in result.difference


def without(topic: str, src: str, seq: int) -> Callable[[RawMessage], bytes | None]:
    def edit(message: RawMessage) -> bytes | None:
        lost = (message.channel.topic.partition("@")[0], message.channel.src, message.seq) == (topic, src, seq)
        return None if lost else message.payload

    return edit


def test_a_lost_input_ends_the_comparison_with_its_name(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    source = sessions("virtual_impedance")
    received = [found.fields()["command_seq"] for found in source.messages(["afm/state"])]
    lost = received[len(received) * 2 // 3]
    cut = edited(source, tmp_path, without("afm/command", "controller@slave", lost))
    result = rerun(Recording(cut), "afm_node@slave")
    assert result.ended_early == (
        f"the recording lacks afm/command, seq {lost} of controller@slave, which the node received"
    )
    assert not result.identical
    assert result.compared["afm/state"] > 400
    assert result.left_out > 0


def test_a_recording_without_an_input_is_refused(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    cut = edited(
        sessions("virtual_impedance"), tmp_path, lambda m: None if m.channel.topic == "afm/command" else m.payload
    )
    with pytest.raises(RecordingError, match="with all inputs: lacks afm/command, seq 0 of controller@slave"):
        rerun(Recording(cut), "afm_node@slave")


def test_a_lost_beginning_is_passed_over(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    source = sessions("wave")
    # one that the node received: of those that waited together at its start it took the newest
    answered = [m.fields()["hand_seq"] for m in source.messages(["teleop/forward"]) if m.src == "controller@master"]
    cut = edited(source, tmp_path, without("haptic/state", "haptic_node@master", answered[2]))
    result = rerun(Recording(cut), "controller@master")
    assert result.identical
    assert result.first_seq["teleop/forward"] > 100
    assert "outside of what the journal" in result.verdict()


def test_the_rerun_begins_after_a_publisher_that_was_recorded_late(
    sessions: Callable[[str], Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the first messages of a source may be missing, and only while the rig starts."""
    monkeypatch.setattr(rerun_module, "_LATEST_START_NS", 0)
    source = sessions("wave")
    late_ns = next(found for found in source.messages(["teleop/backward"]) if found.seq == 600).log_ns

    def edit(message: RawMessage) -> bytes | None:
        is_early = message.channel.topic == "teleop/backward" and message.log_ns < late_ns
        return None if is_early else message.payload

    cut = InMemory(edited(source, tmp_path, edit))
    result = rerun(cut, LINK_NODE)
    assert result.identical, result.verdict()
    assert result.first_seq["teleop/forward@slave"] > 500
    monkeypatch.setattr(rerun_module, "_LATEST_JOIN_NS", -1)
    with pytest.raises(RecordingError, match="with all inputs: lacks teleop/backward, seq 0 of controller@slave"):
        rerun(cut, LINK_NODE)


def test_an_output_more_or_less_is_found(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    result = rerun(sessions("wave"), "controller@master", settings=["controller.deadband.enabled=true"])
    assert result.topic in ("teleop/forward", "law/status")


def test_a_lost_part_of_the_journal_ends_the_comparison(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    cut = edited(sessions("smith"), tmp_path, without("node/journal", "haptic_node@master", 1))
    result = rerun(Recording(cut), "haptic_node@master")
    assert "lacks turns" in result.ended_early


def test_a_recording_without_a_journal_is_refused(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    old = tmp_path / "old.mcap"
    filter_recording(sessions("wave").path, old, Selection.of(exclude=["node/journal"]))
    with pytest.raises(RecordingError, match="has no node/journal of afm_node@slave, which a re-run follows"):
        rerun(Recording(old), "afm_node@slave")


@pytest.mark.parametrize(
    ("node", "reason"),
    [
        ("delay_node@slave", "it is an endpoint of delay_node@master: run that again"),
        ("recorder@master", "the recording is what it makes of its inputs"),
        ("recorder@slave", "the recording is what it makes of its inputs"),
        ("launcher@slave", "it acts on processes and on time, which are not in a recording"),
        ("console@master", "its commands are those that a person typed"),
        ("console_lab@slave", "its commands are those that a person typed"),
        ("player@master", "it repeats the messages of another recording"),
        ("viz_node@master", "it only shows what the others send"),
        ("thermometer@master", "it is not in the table of nodes"),
    ],
)
def test_why_a_node_cannot_be_run_again_is_reported(
    sessions: Callable[[str], Recording], node: str, reason: str
) -> None:
    with pytest.raises(
        ConfigError, match=f"{node}: cannot be run again: {reason}.*; (known are|those that can are) delay_node@"
    ):
        rerun(sessions("wave"), node)


def test_another_seed_or_delay_of_the_link_is_found(sessions: Callable[[str], Recording]) -> None:
    recording = sessions("wave")
    result = rerun(recording, LINK_NODE, settings=["delay_node.seed=1"])
    assert result.topic == "link/fates"
    assert result.field.startswith("fates.")
    result = rerun(recording, LINK_NODE, settings=["delay_node.forward.delay_s=0.002000001"])
    assert (result.topic, result.field) == ("link/fates", "fates.0.delay_ns")


def forwarded(edit: Callable[[int, RawMessage], bytes | None]) -> Callable[[RawMessage], bytes | None]:
    """Edit what came out of the link on teleop/backward, counted from 0."""
    seen: list[int] = []

    def edit_all(message: RawMessage) -> bytes | None:
        if message.channel.topic != "teleop/backward@master":
            return message.payload
        seen.append(1)
        return edit(len(seen) - 1, message)

    return edit_all


def test_a_forwarded_message_that_is_another_is_found(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    def flip(place: int, message: RawMessage) -> bytes:
        fields = msgpack.unpackb(message.payload)
        return bytes(msgpack.packb(fields | {"separation_m": 1.0})) if place == 300 else message.payload

    result = rerun(Recording(edited(sessions("wave"), tmp_path, forwarded(flip))), LINK_NODE)
    assert (result.topic, result.field) == ("teleop/backward", "separation_m")
    assert f"teleop/backward, seq {result.seq}, " in result.difference
    assert "forwarded at delay_node@master: re-run separation_m: " in result.difference
    assert "against 1.0 recorded" in result.difference


@pytest.mark.check("takes 0.8 s")
def test_what_only_the_recorder_missed_of_the_link_is_passed_over(
    sessions: Callable[[str], Recording], tmp_path: Path
) -> None:
    """How many messages there were is in the journal."""
    whole = rerun(sessions("wave"), LINK_NODE)
    cut = edited(sessions("wave"), tmp_path, forwarded(lambda n, message: None if n == 300 else message.payload))
    result = rerun(Recording(cut), LINK_NODE)
    assert result.identical
    assert result.compared["teleop/backward@master"] == whole.compared["teleop/backward@master"] - 1


def test_what_the_link_forwarded_in_another_order_is_found(
    sessions: Callable[[str], Recording], tmp_path: Path
) -> None:
    payloads = [found.payload for found in sessions("wave").messages(["teleop/backward@master"])]
    payloads[300], payloads[301] = payloads[301], payloads[300]
    swap = forwarded(lambda n, message: payloads[n])
    result = rerun(Recording(edited(sessions("wave"), tmp_path, swap)), LINK_NODE)
    assert result.topic == "teleop/backward"
    assert "against teleop/backward, seq" in result.difference


def test_a_message_too_much_in_the_journal_of_the_link_is_found(
    sessions: Callable[[str], Recording], tmp_path: Path
) -> None:
    seen: list[int] = []

    def edit(message: RawMessage) -> bytes:
        if message.channel.topic == "node/journal" and message.channel.src == LINK_NODE:
            seen.append(1)
            if len(seen) == 2:
                fields = msgpack.unpackb(message.payload)
                fields["outputs"]["delay_node@slave"] += 1
                return bytes(msgpack.packb(fields))
        return message.payload

    result = rerun(Recording(edited(sessions("wave"), tmp_path, edit)), LINK_NODE)
    assert "delay_node@slave, seq " in result.difference
    assert "messages up to here, its journal counts" in result.difference


@pytest.mark.check("takes 1.3 s")
def test_the_same_seed_gives_the_same_session(sessions: Callable[[str], Recording], tmp_path: Path) -> None:
    first, second = (record_session(tmp_path / name, 11, duration_s=0.4) for name in ("a", "b"))
    results: list[list[bytes]] = [
        [found.payload for found in Recording(path).messages(["afm/state", "haptic/state"])] for path in (first, second)
    ]
    assert results[0] == results[1]
    assert len(results[0]) > 600


def test_the_verdict_says_what_was_compared() -> None:
    same = RerunResult(node="n@s", compared={"afm/state": 3}, first_seq={"afm/state": 0}, left_out=0, identical=True)
    assert same.verdict() == "the same in every message: 3 afm/state"

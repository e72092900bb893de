"""Any node of the rig, under any law, is re-run bit by bit by its journal, and what was changed is found."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
from virtual_rig import NODES, VirtualRig, record_session

from analysis.process_replay import RerunResult, rerun
from proto.errors import ConfigError, RecordingError
from proto.messages import Array
from recording.channel_filter import Selection
from recording.reader import RawMessage, Recording
from recording.rewrite import filter_recording
from recording.writer import FileSettings, RecordingWriter
from services.controller.config import LAWS

COMPARED = {
    "controller@master": {"teleop/forward", "haptic/command", "law/status"},
    "controller@slave": {"afm/command", "teleop/backward", "law/status"},
    "afm_node@slave": {"afm/state"},
    "haptic_node@master": {"haptic/state"},
}


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    made: dict[str, Path] = {}

    def session(law: str) -> Path:
        if law not in made:
            folder = tmp_path_factory.mktemp(law)
            made[law] = record_session(folder, seed=len(made) + 7, settings=[f"controller.law={law}"])
        return made[law]

    return session


def edited(source: Path, folder: Path, edit: Callable[[RawMessage], bytes | None]) -> Path:
    """Copy a recording; `edit` gives the payload of a message, None to leave it out."""
    recording = Recording(source)
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    for name, found in recording.attachment_records.items():
        writer.attach(name, found.media_type, found.data, found.log_time)
    channels: dict[Any, int] = {}
    for message in recording.raw():
        payload = edit(message)
        if payload is None:
            continue
        facts = dict(message.channel.metadata)
        place = (facts["topic"], facts["src"], facts["site"])
        if place not in channels:
            channels[place] = writer.channel(*place)
        writer.write(channels[place], message.log_ns, message.publish_ns, message.seq, payload)
    writer.finish()
    return writer.path


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("law", LAWS)
def test_a_rerun_gives_the_same_bits(sessions: Callable[[str], Path], law: str, node: str) -> None:
    recording = Recording(sessions(law))
    result = rerun(recording, node)
    assert result.difference == ""
    assert result.identical, result.verdict()
    assert result.left_out == 0
    assert set(result.compared) == COMPARED[node]
    for topic, count in result.compared.items():
        published = [found for found in recording.messages([topic]) if found.src == node]
        assert count == len(published)
        assert result.first_seq[topic] == 0
        assert len(published) > (70 if topic == "law/status" else 500)


def test_the_hand_touches_the_sample(sessions: Callable[[str], Path]) -> None:
    """Without it nothing of a law would be seen."""
    for law in LAWS:
        states = [found.fields() for found in Recording(sessions(law)).messages(["afm/state"])]
        assert {state["mode"] for state in states} >= {"retracted", "follow"}, law
        assert any(state["in_contact"] for state in states), law


@pytest.mark.parametrize("node", NODES)
def test_a_rerun_begins_in_the_middle(sessions: Callable[[str], Path], tmp_path: Path, node: str) -> None:
    """The state in the journal is all that a node needs: here it begins while the tip is pressed down."""
    for law in LAWS:
        cut = tmp_path / f"{law}.mcap"
        filter_recording(sessions(law), cut, start_s=0.6)
        result = rerun(Recording(cut), node)
        assert result.identical, f"{law}: {result.verdict()}"
        assert min(result.first_seq.values()) > 30
        assert result.left_out > 0
        assert sum(result.compared.values()) > 400


def test_a_changed_law_is_rerun(tmp_path: Path) -> None:
    rig = VirtualRig(tmp_path, seed=3)
    rig.run_until(0.15)
    rig.command("arm", "*")
    for time_s, law in ((0.3, "wave"), (0.6, "smith")):
        rig.run_until(time_s)
        rig.command("set", "controller", law=law)
    rig.run_until(1.2)
    path = rig.finish()
    late = tmp_path / "late.mcap"
    filter_recording(path, late, start_s=0.4)
    for node in NODES:
        assert rerun(Recording(path), node).identical
        # the law that was in force when the part begins is in the state
        assert rerun(Recording(late), node).identical, rerun(Recording(late), node).verdict()


def test_the_deadband_and_its_statistics_are_rerun(tmp_path: Path) -> None:
    path = record_session(tmp_path, 5, ["controller.deadband.enabled=true"])
    results = [rerun(Recording(path), node) for node in NODES]
    assert all(result.identical for result in results), [result.verdict() for result in results]


def test_a_changed_gain_is_found(sessions: Callable[[str], Path]) -> None:
    recording = Recording(sessions("virtual_impedance"))
    result = rerun(recording, "controller@master", settings=["controller.virtual_impedance.force_gain=10.0000001"])
    assert (result.topic, result.field) == ("haptic/command", "position_m.2")
    assert f"haptic/command, seq {result.seq}, {result.time_s:.6f} s after the start: re-run" in result.difference


def swapped(message: RawMessage, kinds: tuple[int, int], after: int) -> bytes:
    """Swap two neighbouring turns of different kinds in a journal, each at the time of its place."""
    fields = msgpack.unpackb(message.payload)
    arrays = {name: Array.model_validate(fields[name] | {"shape": tuple(fields[name]["shape"])}) for name in FIELDS}
    columns = {name: found.to_numpy().copy() for name, found in arrays.items()}
    pairs = zip(columns["input"].tolist()[after:], columns["input"].tolist()[after + 1 :], strict=False)
    place = after + next(n for n, pair in enumerate(pairs) if pair == kinds)
    for name in ("kind", "input", "number"):
        columns[name][[place, place + 1]] = columns[name][[place + 1, place]]
    return bytes(msgpack.packb(fields | {name: Array.from_numpy(columns[name]).model_dump() for name in FIELDS}))


FIELDS = ("kind", "time_ns", "input", "number")


@pytest.mark.parametrize("node", ["controller@slave", "controller@master", "haptic_node@master"])
def test_a_swapped_order_is_found(sessions: Callable[[str], Path], tmp_path: Path, node: str) -> None:
    seen: list[int] = []

    def edit(message: RawMessage) -> bytes:
        if message.channel.topic == "node/journal" and message.channel.src == node:
            seen.append(1)
            if len(seen) == 2:
                first = -1 if node.startswith("haptic") else 0
                return swapped(message, (first, 1 + first), 100)
        return message.payload

    result = rerun(Recording(edited(sessions("virtual_impedance"), tmp_path, edit)), node)
    assert result.difference != ""
    assert "after the start: " in result.difference


def without(topic: str, src: str, seq: int) -> Callable[[RawMessage], bytes | None]:
    def edit(message: RawMessage) -> bytes | None:
        lost = (message.channel.topic.partition("@")[0], message.channel.src, message.seq) == (topic, src, seq)
        return None if lost else message.payload

    return edit


def test_a_lost_input_ends_the_comparison_with_its_name(sessions: Callable[[str], Path], tmp_path: Path) -> None:
    source = sessions("virtual_impedance")
    received = [found.fields()["command_seq"] for found in Recording(source).messages(["afm/state"])]
    lost = received[len(received) * 2 // 3]
    cut = edited(source, tmp_path, without("afm/command", "controller@slave", lost))
    result = rerun(Recording(cut), "afm_node@slave")
    assert result.ended_early == (
        f"the recording lacks afm/command, seq {lost} of controller@slave, which the node received"
    )
    assert not result.identical
    assert result.compared["afm/state"] > 400
    assert result.left_out > 0


def test_a_lost_beginning_is_passed_over(sessions: Callable[[str], Path], tmp_path: Path) -> None:
    cut = edited(sessions("wave"), tmp_path, without("haptic/state", "haptic_node@master", 3))
    result = rerun(Recording(cut), "controller@master")
    assert result.identical
    assert result.first_seq["teleop/forward"] > 100
    assert "outside of what the journal" in result.verdict()


def test_an_output_more_or_less_is_found(sessions: Callable[[str], Path], tmp_path: Path) -> None:
    result = rerun(Recording(sessions("wave")), "controller@master", settings=["controller.deadband.enabled=true"])
    assert result.topic in ("teleop/forward", "law/status")


def test_a_lost_part_of_the_journal_ends_the_comparison(sessions: Callable[[str], Path], tmp_path: Path) -> None:
    cut = edited(sessions("smith"), tmp_path, without("node/journal", "haptic_node@master", 1))
    result = rerun(Recording(cut), "haptic_node@master")
    assert "lacks turns" in result.ended_early


def test_a_recording_without_a_journal_is_refused(sessions: Callable[[str], Path], tmp_path: Path) -> None:
    old = tmp_path / "old.mcap"
    filter_recording(sessions("wave"), old, Selection.of(exclude=["node/journal"]))
    with pytest.raises(RecordingError, match="has no node/journal of afm_node@slave, which a re-run follows"):
        rerun(Recording(old), "afm_node@slave")


def test_a_node_without_a_journal_is_named(sessions: Callable[[str], Path]) -> None:
    with pytest.raises(ConfigError, match="delay_node@master: cannot be re-run, it keeps no journal; those that can"):
        rerun(Recording(sessions("wave")), "delay_node@master")


def test_the_same_seed_gives_the_same_session(sessions: Callable[[str], Path], tmp_path: Path) -> None:
    first, second = (record_session(tmp_path / name, 11, duration_s=0.4) for name in ("a", "b"))
    results: list[list[bytes]] = [
        [found.payload for found in Recording(path).messages(["afm/state", "haptic/state"])] for path in (first, second)
    ]
    assert results[0] == results[1]
    assert len(results[0]) > 600


def test_the_verdict_says_what_was_compared() -> None:
    same = RerunResult(node="n@s", compared={"afm/state": 3}, first_seq={"afm/state": 0}, left_out=0, identical=True)
    assert same.verdict() == "the same in every message: 3 afm/state"

"""What a run of a node knows of its emergency stops, and the file in which the newest is kept."""

import os
import stat
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest
from stopped_devices import HAND, MS, TIP, World

from telenano.runtime.loop.commands import stop_of
from telenano.runtime.loop.estop_latch import EstopLatch, begins_motion
from telenano.runtime.loop.kept_stop import forget, keep, kept
from telenano.timing.clock import process_start_ns
from telenano.wire import encode
from telenano.wire.messages import SessionControl

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("command", "parameters", "begins"),
    [
        ("arm", {}, True),
        ("set", {"program": "scan"}, True),
        ("set", {"program": "resume"}, True),
        ("set", {"program": "abort"}, False),
        ("set", {"program": "pause"}, False),
        ("set", {"lateral.x_m": 1e-7}, False),
        ("start", {}, False),
        ("stop", {}, False),
        ("estop", {}, False),
    ],
)
def test_what_begins_a_motion(command: str, parameters: dict[str, Any], begins: bool) -> None:
    assert begins_motion(command, parameters) is begins


def test_nothing_has_to_be_quoted_until_there_was_a_stop_and_then_the_newest() -> None:
    latch = EstopLatch()
    assert latch.reason_against(None, 0) == latch.reason_against(latch.quotation, 0) == ""
    before = latch.quotation
    assert "estop_age_s" not in latch.facts(0)
    latch.record("a", b"", SECOND)
    first = latch.quotation
    assert latch.facts(3 * SECOND) == {"latch": first, "estop_age_s": 2.0}
    for quoted in (None, before):
        assert latch.reason_against(quoted, 3 * SECOND).endswith("the newest emergency stop, which came 2.0 s ago")
    assert latch.reason_against(first, 3 * SECOND) == ""
    # a repetition of the same stop is one as well
    latch.record("a", b"", 2 * SECOND)
    assert latch.reason_against(first, 3 * SECOND) != ""
    other = EstopLatch()
    assert other.reason_against(first, 0) == "it refers to an earlier run of this device"


def test_each_stop_is_counted_and_its_copies_as_well() -> None:
    latch = EstopLatch()
    counts = []
    for identifier in ("a", "a", "b"):
        latch.record(identifier, b"", SECOND)
        counts.append(latch.count)
    assert counts == [1, 2, 3]


def test_a_count_of_this_run_that_was_never_reached_begins_no_motion() -> None:
    latch = EstopLatch()
    run = latch.quotation.rpartition("-")[0]
    assert latch.reason_against(f"{run}-1", SECOND).startswith("it does not refer to the newest emergency stop")
    latch.record("a", b"", SECOND)
    assert latch.reason_against(f"{run}-2", SECOND) != ""
    assert latch.reason_against(f"{run}-1", SECOND) == ""


def test_the_newest_stop_is_kept_as_it_came_first_until_the_node_is_armed(tmp_path: Path) -> None:
    latch = EstopLatch(tmp_path / "x.kept")
    assert latch.kept() is None
    assert latch.record("a", b"one", SECOND) == ""
    # a copy of it is not written once more, and another stop is
    latch.record("a", b"copy", 2 * SECOND)
    assert (latch.kept(), latch.newest_id) == (b"one", "a")
    latch.record("b", b"two", 3 * SECOND)
    assert (latch.kept(), latch.newest_id) == (b"two", "b")
    latch.release()
    assert (latch.kept(), latch.newest_id, list(tmp_path.iterdir())) == (None, "", [])
    # a copy that comes after the arming stops the node as any stop does
    latch.record("b", b"two", 4 * SECOND)
    assert latch.kept() == b"two"


def test_a_latch_without_a_file_keeps_nothing() -> None:
    latch = EstopLatch()
    assert latch.record("a", b"one", SECOND) == ""
    latch.release()
    assert (latch.kept(), latch.count) == (None, 1)


def test_a_stop_is_kept_whole_for_its_user_alone_until_it_is_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "x.kept"
    assert kept(path) is None
    assert keep(path, b"one") == ""
    assert keep(path, b"two") == ""
    assert kept(path) == b"two"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == [path]
    forget(path)
    forget(path)
    assert kept(path) is None


def test_a_link_in_the_place_of_the_file_is_not_written_through(tmp_path: Path) -> None:
    target = tmp_path / "theirs"
    target.write_bytes(b"theirs")
    path = tmp_path / "x.kept"
    path.symlink_to(target)
    path.with_name(f"{path.name}.{os.getpid()}").symlink_to(target)
    assert keep(path, b"stop") == ""
    assert (target.read_bytes(), kept(path), path.is_symlink()) == (b"theirs", b"stop", False)


def test_a_stop_that_cannot_be_kept_is_in_force_and_reported(tmp_path: Path) -> None:
    gone = tmp_path / "gone" / "x.kept"
    assert keep(gone, b"stop") == f"{gone}: the emergency stop cannot be kept: No such file or directory"
    world = World(tmp_path)
    (folder := tmp_path / "taken").mkdir()
    world.devices[TIP].loop._commands.latch.path = folder
    world.stop(5 * SECOND)
    world.run(SECOND)
    assert world.modes() == {TIP: "estop", HAND: "estop"}
    assert any(e.kind == "fault" and "cannot be kept" in e.text for e in world.heard if e.src == TIP)


@pytest.mark.parametrize("content", [b"", b"garbage", b"\x80", bytes(100_000), encode(stop_of(TIP, 5))])
def test_whatever_is_in_the_file_the_device_is_stopped(tmp_path: Path, content: bytes) -> None:
    (tmp_path / f"{TIP}.kept").write_bytes(content)
    world = World(tmp_path)
    assert world.modes() == {TIP: "estop", HAND: "free"}


def test_no_other_command_is_taken_from_the_file(tmp_path: Path) -> None:
    fields = {"seq": 0, "t_ns": 0, "src": "estop@slave", "v": 1, "id": "a", "target": "*", "parameters": {}}
    arm = msgspec.convert({**fields, "command": "arm"}, SessionControl)
    world = World(tmp_path)
    (tmp_path / f"{TIP}.kept").write_bytes(encode(arm))
    world.run(SECOND)
    assert world.devices[TIP].mode == "estop"


def test_a_device_that_runs_finds_a_stop_whose_sender_was_ended_before_it_could_send(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.arm()
    world.run(SECOND)
    assert world.devices[TIP].mode == "follow"
    keep(world.devices[TIP].kept, encode(stop_of(TIP, world.clock.now_ns())))
    world.run(600 * MS)
    assert world.devices[TIP].mode == "estop"


def test_a_switch_of_the_device_itself_voids_what_came_before(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.arm()
    world.run(SECOND)
    node: Any = world.devices[HAND].loop.node
    client = world.arm(HAND)
    # pressed when the command is on its way
    world.devices[HAND].stands_still = True
    world.run(40 * MS)
    node._memory.estop_requested, node.own_stops = True, 1
    world.go_on()
    world.run(3 * SECOND)
    assert client.void or client.answers
    assert world.devices[HAND].mode == "estop"
    assert kept(world.devices[HAND].kept)


def test_a_process_knows_when_it_was_started() -> None:
    age_s = (time.monotonic_ns() - process_start_ns()) * 1e-9
    assert 0.0 < age_s < time.clock_gettime(time.CLOCK_BOOTTIME)
    # at least as long ago as the time of the processor that it has used
    assert age_s > 0.5 * time.process_time() / (os.cpu_count() or 1)

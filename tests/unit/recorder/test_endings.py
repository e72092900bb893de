"""Whoever ends, and however: a recording tells exactly what it lacks, and of no restart but those that there were.

What is counted comes from `told_and_counted`, which reads the files without anything of this project.
"""

import errno
import io
from contextlib import closing
from itertools import groupby
from pathlib import Path
from typing import IO, Any, cast

import pytest
import told_and_counted
from mcap.records import Channel

from telenano.recording.disk import OwnDisk
from telenano.recording.multi_file import open_recordings
from telenano.recording.verify import verify
from telenano.timing.clock import Clock
from telenano.virtual.rig import ARMED_S, LINK_ENDPOINT, LINK_NODE, STARTED_S, VirtualRig
from telenano.wire.nodes import RECORDER

HAND, TIP, MASTER_HALF, SLAVE_HALF = "haptic_node@master", "afm_node@slave", "controller@master", "controller@slave"
# What ends together: a node, or all nodes of a process of a site.
PROCESSES = {
    "the hand": (HAND,),
    "the tip": (TIP,),
    "the master half": (MASTER_HALF,),
    "the slave half": (SLAVE_HALF,),
    "the link": (LINK_NODE,),
    "the recorder": (RECORDER,),
    "the process of the hand's site": (HAND, MASTER_HALF, LINK_NODE),
    "the process of the tip's site": (TIP, SLAVE_HALF),
}
# Time for which it is away, and then until the recorder is connected to it again; lead of the clock that it has then
# [s].
HOW = {
    "in order": (0.3, 0.03, 0.0),
    "by an error": (0.2, 0.03, 0.0),
    "killed": (0.25, 0.03, 0.0),
    "killed, with the recorder connected at once": (0.1, 0.0, 0.0),
    "in order, and replaced at once": (0.0, 0.015, 0.0),
    "in order, and its clock is set back": (0.2, 0.03, -30.0),
    "killed, and its clock is set ahead": (0.2, 0.03, 7.0),
}


class SetClock:
    """The clock of a machine that was set."""

    def __init__(self, base: Clock, lead_s: float) -> None:
        self._base = base
        self.epoch_offset_ns = base.epoch_offset_ns + round(1e9 * lead_s)

    def monotonic_ns(self) -> int:
        return self._base.monotonic_ns()

    def now_ns(self) -> int:
        return self.monotonic_ns() + self.epoch_offset_ns


class EndingRig(VirtualRig):
    """A rig whose recorder needs a time to connect to a process that has come back."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._connected_ns: dict[str, int] = {}
        self._clocks: dict[str, Clock] = {}
        super().__init__(folder, seed, ["realtime.rate_hz=250"])

    def clock_of(self, key: str) -> Clock:
        return self._clocks.get(key, self.clock)

    def _record(self, endpoint: str, topic: str, payload: bytes, sent_ns: int) -> None:
        if sent_ns >= self._connected_ns.get(endpoint, 0):
            super()._record(endpoint, topic, payload, sent_ns)

    def ends(self, key: str, how: str) -> None:
        """End the process of a node."""
        if how.startswith("by an error"):
            self.loops[key].report_failure(RuntimeError("a plug-in of a person"))
        if not how.startswith("killed"):
            self.stop(key)
        elif key == RECORDER:
            # Its file ends where it was flushed last.
            self.loops[key].node._intake.writer.abandon()
        self.leave(key)

    def comes_back(self, key: str, connecting_s: float, lead_s: float) -> None:
        """Start the process of a node again, with a clock that is ahead of that of before."""
        after_ns = self.clock.monotonic_ns() + round(1e9 * connecting_s)
        for endpoint in (LINK_NODE, LINK_ENDPOINT) if key == LINK_NODE else (key,):
            self._connected_ns[endpoint] = after_ns
            self._endpoints.pop(endpoint, None)
            self._clocks[endpoint] = SetClock(self.clock_of(endpoint), lead_s)
        self.start(key)


def recorded(folder: Path, who: str, how: str) -> Path:
    """Record a session in which a process ends twice, and comes back each time."""
    away_s, connecting_s, lead_s = HOW[how]
    with closing(EndingRig(folder, seed=len(who) + len(how))) as rig:
        rig.run_until(ARMED_S)
        rig.command("arm", "*", place="hand")
        rig.run_until(STARTED_S)
        rig.command("start", "haptic_node")
        for at_s in (0.6, 1.3):
            rig.run_until(at_s)
            for key in PROCESSES[who]:
                rig.ends(key, how)
            rig.run_until(at_s + away_s)
            for key in PROCESSES[who]:
                rig.comes_back(key, connecting_s, lead_s)
        rig.run_until(2.0)
        rig.finish()
    return folder


@pytest.mark.check("takes 1 s each")
@pytest.mark.drawn(0.5, "telenano/recording/", "telenano/wire/sequence.py", "services/recorder/")
@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("who", PROCESSES)
def test_what_a_recording_lacks_is_told_and_who_did_not_end_was_not_restarted(
    tmp_path: Path, who: str, how: str
) -> None:
    if who == "the recorder" and HOW[how][2]:
        pytest.skip("the files of a recorder whose clock is set have an order of their own")
    paths = sorted(recorded(tmp_path, who, how).glob("session*.mcap"))
    assert [fault for path in paths for fault in told_and_counted.check(path)] == []
    counted = told_and_counted.lacking(*paths)
    information = open_recordings(paths).info()
    told = {(one.channel_topic, one.src): one.lost for one in information.channels if one.lost}
    assert told == counted
    # What the link did not carry was not sent to the recorder; all else was, and so was what it passed on before it
    # ended, or while nobody recorded.
    direct = sum(count for (channel, _), count in counted.items() if "@" not in channel)
    total = sum(counted.values())
    assert direct <= information.lost <= total
    assert information.lost == {"the recorder": total}.get(who, direct) or LINK_NODE in PROCESSES[who]
    ended = {*PROCESSES[who], *((LINK_ENDPOINT,) if LINK_NODE in PROCESSES[who] else ())}
    restarted = {one.src for one in information.channels if one.restarts and not one.topic.startswith("recorder/")}
    assert restarted == ended - {RECORDER} | ({RECORDER} & ended)
    findings = verify(paths).findings
    said = {one.text.partition(" was restarted")[0] for one in findings if " was restarted" in one.text}
    assert said <= ended
    # Something is missing of every case, or the table shows nothing.
    assert bool(counted) == is_lossy(who, how)


def test_all_messages_of_a_console_are_lacking_of_which_only_the_end_was_heard() -> None:
    console = "console@master"

    def seen(topic: str, run: int, seq: int, **fields: Any) -> told_and_counted.Seen:
        channel = Channel(
            id=1,
            schema_id=1,
            topic=topic,
            message_encoding="msgpack",
            metadata={"topic": topic, "src": console, "site": "master", "via": "direct"},
        )
        fields |= {"src": console, "run": run, "seq": seq, "t_ns": run}
        return told_and_counted.Seen(channel, seq, run, run, fields)

    ended = {"state": "ended", "sent.session/control": 2, "sent.session/event": 1}
    account = told_and_counted.Account(
        [
            seen("session/control", 10, 1, id="arm"),
            seen("session/event", 10, 0, data=ended),
            seen("session/event", 20, 0, data=ended),
            seen("session/control", 30, 0, id="stop"),
        ]
    )
    assert account.streams["session/control", console].lacking() == [((0, 1), 20)]
    assert account.streams["session/event", console].lacking() == []


def is_lossy(who: str, how: str) -> bool:
    """Return whether a case loses messages at all: of a node, the first ones before the recorder is connected."""
    away_s, connecting_s, _ = HOW[how]
    return connecting_s > 0.0 or LINK_NODE in PROCESSES[who] or (who == "the recorder" and away_s > 0.0)


class FullDisk(OwnDisk):
    """A disk that is full at times: a write that finds no room is incomplete, as on a real one."""

    def __init__(self) -> None:
        self.is_full = False

    def create(self, path: Path) -> IO[bytes]:
        disk, file = self, super().create(path)

        class Limited(io.BufferedWriter):
            def write(self, data: Any) -> int:
                if disk.is_full:
                    super().write(memoryview(data)[: len(data) // 2])
                    raise OSError(errno.ENOSPC, "No space left on device")
                return super().write(data)

        return Limited(cast(io.BufferedWriter, file).detach())

    def free_bytes(self, path: Path) -> int | None:
        return 0 if self.is_full else None


@pytest.mark.check("takes 1 s each")
@pytest.mark.parametrize("at_s", [(0.7,), (0.31, 1.8), (0.9, 2.6, 4.1)])
def test_a_recording_goes_on_when_its_disk_has_room_again_and_says_what_it_lost(
    tmp_path: Path, at_s: tuple[float, ...]
) -> None:
    disk = FullDisk()
    with closing(VirtualRig(tmp_path, 3, ["realtime.rate_hz=250"], disk=disk)) as rig:
        intake, node = rig.loops[RECORDER].node._intake, rig.loops[RECORDER].node
        for full_s in at_s:
            rig.run_until(full_s)
            disk.is_full = True
            rig.run_until(full_s + 0.4)
            assert "No space left on device" in intake.fault
            assert (node.state, node.status().partition(":")[0]) == ("safe", "not recording")
            disk.is_full = False
            rig.run_until(full_s + 1.6)
            assert (intake.fault, node.state) == ("", "running")
        rig.run_until(at_s[-1] + 2.0)
        rig.finish()
    paths = sorted(tmp_path.glob("session*.mcap"))
    assert len(paths) == 1 + len(at_s)
    counted = told_and_counted.lacking(*paths)
    assert min(counted[channel, src] for channel, src in (("haptic/state", HAND), ("afm/state", TIP))) > 100
    # The further files begin with the gaps of what was received and not written; what was received before there was
    # anything in the first file, only the recorder knows.
    told, begun = told_and_counted.told(*paths), told_and_counted.channels(paths[0])
    assert {place: count for place, count in told.items() if place in begun} == {
        place: count for place, count in counted.items() if place in begun
    }
    assert all(told[place] >= count for place, count in counted.items())
    information = open_recordings(paths).info()
    assert {(one.channel_topic, one.src): one.lost for one in information.channels if one.lost} == counted
    assert information.lost == sum(counted.values())
    notes = [text for text in information.missing if text.startswith("nothing was recorded for") and "No space" in text]
    assert len(notes) == len(at_s)
    events = [event for event in rig.received("session/event", RECORDER) if event.kind == "recording"]
    # A fault is repeated every second for who connects later.
    states = [state for state, _ in groupby(str(event.data["state"]) for event in events)]
    assert states == ["started", *("failed", "started", "resumed") * len(at_s), "finished"]


def test_a_quota_that_is_used_up_stays_the_end(tmp_path: Path) -> None:
    settings = ["realtime.rate_hz=100", "recorder.quota_bytes=100000", "recorder.quota_policy=stop"]
    with closing(VirtualRig(tmp_path, 3, settings)) as rig:
        rig.run_until(3.0)
        assert "quota" in rig.loops[RECORDER].node._intake.fault
    assert [path.name for path in tmp_path.glob("session*.mcap")] == ["session.mcap"]

"""Whoever ends, and however: a recording tells exactly what it lacks, and of no restart but those that there were.

What is counted comes from `told_and_counted`, which reads the files without anything of this project.
"""

from contextlib import closing
from pathlib import Path

import pytest
import told_and_counted

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


def is_lossy(who: str, how: str) -> bool:
    """Return whether a case loses messages at all: of a node, the first ones before the recorder is connected."""
    away_s, connecting_s, _ = HOW[how]
    return connecting_s > 0.0 or LINK_NODE in PROCESSES[who] or (who == "the recorder" and away_s > 0.0)

"""SIGSTOP and SIGCONT of each process of a real rig: nothing past its deadline is obeyed, and the tip does not jump.

The recording is the witness. Of each state of a device it has the command in force and the hand's sample behind it; of
the link it has the delay of each message. It is endurance, and of one law and link: the others are in virtual time, and
without the doubt whether the machine was busy, in `tests/simulation`.
"""

import contextlib
import math
import os
import signal
import time
import urllib.request
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from browser_page import View
from ledger import record
from stack_rig import BOTH_WAYS, PATIENCE_S, Rig

from telenano.recording.reader import Recording
from telenano.wire.topics import LOOP_DEADLINE_S

MS = 1_000_000
HAND, LINK, TIP = "haptic_node@master", "delay_node@master", "afm_node@slave"
NODES = (HAND, "controller@master", LINK, "controller@slave", TIP)
RECORDER, PAGE = "recorder@master", "the page's server"
# a moment within the deadline, one in which the tip is withdrawn, and one after which a node counts as silent [s]
SHORT_S = (0.05, 0.3, 2.0)
DEADLINE_MS = LOOP_DEADLINE_S * 1e3
# a state is sent after it was decided: where that took longer, the process was stopped in between, and so much of what
# it had in hand it can only finish
IN_HAND_NS = 5 * MS
GRAIN_MS = IN_HAND_NS / MS
MOST_NM = 0.5
# delay of the link in each direction
LINK_MS = 20.0
SOON_NS = 20 * MS
# the greatest force of a tip that is held or withdrawn, to that of the swings
MOST_FORCE = 1.1
SWING = [
    {"time_s": round(0.05 * n, 2), "position_m": 5.5e-3 - 3.5e-3 * math.cos(0.1 * math.pi * n)} for n in range(1800)
]


class Stall(NamedTuple):
    node: str
    begin_ns: int
    end_ns: int


class Findings(NamedTuple):
    """The greatest ages in a session [ms], and ways of the tip after a stall [nm]; what was reported [s].

    `force_ratio` is the greatest force on the tip from the first stall on, divided by that of the swings before it.
    """

    command_ms: float
    hand_ms: float
    answer_ms: float
    soon_nm: float
    queued_nm: float
    force_ratio: float
    reported_s: dict[Stall, float]


class Session:
    """A rig under wave variables, over a link, with a hand that swings; its processes are stopped one after another."""

    def __init__(self, folder: Path, processes: str) -> None:
        self.rig, self.stalls = Rig(folder, processes), list[Stall]()
        scenario = {
            "name": "stalls",
            "description": "A hand swings, and processes are stopped",
            "duration_s": 600.0,
            "haptic_node": {"operator": {"kind": "impedance", "path": SWING}},
            "afm_node": {"rest_distance_m": 1e-8},
            "controller": {"law": "wave"},
        }
        path = folder / "stalls.yaml"
        path.write_text(yaml.safe_dump(scenario))
        self.rig.start("--round-trip-ms", str(2.0 * LINK_MS), scenario=str(path), rate=())
        try:
            self.rig.wait_until(self.rig.running, "a running session")
        except BaseException:
            self.rig.close()
            raise
        time.sleep(1.0)

    def stall(self, node: str, duration_s: float, process_id: int | None = None) -> None:
        process_id = process_id or self.rig.process_of(node)
        assert process_id is not None
        begin_ns = time.time_ns()
        os.kill(process_id, signal.SIGSTOP)
        time.sleep(duration_s)
        end_ns = time.time_ns()
        os.kill(process_id, signal.SIGCONT)
        self.stalls.append(Stall(node, begin_ns, end_ns))
        # the last of what was in the link, and the coupling there and back
        time.sleep(0.2 + 2e-3 * LINK_MS)

    def arm(self) -> None:
        """Take the tip up again, as an operator does after a withdrawal."""
        self.rig.wait_until(
            lambda: self.rig.telenano("session", "arm", "--target", "afm_node").returncode == 0, "an armed instrument"
        )
        time.sleep(0.2 + 2e-3 * LINK_MS)

    def end(self) -> Findings:
        code, _, err = self.rig.stop()
        assert code in (0, 1), err
        assert "Traceback" not in err
        recording = Recording(self.rig.out / "session.mcap")
        tips = [found.decode() for found in recording.messages(["afm/state"])]
        hands = [found.decode() for found in recording.messages(["haptic/state"])]
        events = [found.decode() for found in recording.messages(["session/event"])]
        commands = {found.seq: found.decode() for found in recording.messages(["afm/command"])}
        obeyed = [(tip, commands[tip.command_seq]) for tip in in_time(tips) if tip.mode == "follow"]
        coupled = [hand for hand in in_time(hands) if hand.mode == "position" and hand.answered_t_ns]
        assert len(obeyed) > 1000
        assert len(coupled) > 500
        ways = [ways_nm(tips, commands, stall) for stall in self.stalls]
        return Findings(
            command_ms=max((tip.t_ns - command.t_ns) / MS for tip, command in obeyed),
            hand_ms=max((tip.t_ns - command.hand_t_ns) / MS for tip, command in obeyed) - LINK_MS,
            answer_ms=max((hand.t_ns - hand.answered_t_ns) / MS for hand in coupled) - 2.0 * LINK_MS,
            soon_nm=max(soon for soon, _ in ways),
            queued_nm=max(queued for _, queued in ways),
            force_ratio=force_ratio(tips, self.stalls[0].begin_ns),
            reported_s={stall: reported_s(events, stall) for stall in self.stalls},
        )


def in_time(states: Sequence[Any]) -> list[Any]:
    """Leave out what a device was about to say when it was stopped, by whomever."""
    return [state for before, state in pairwise(states) if state.t_ns - before.t_ns < IN_HAND_NS]


def ways_nm(tips: Sequence[Any], commands: dict[int, Any], stall: Stall) -> tuple[float, float]:
    """Give how far the tip went soon after a stall, and by commands from before its end [nm]; withdrawal apart."""
    soon, queued = [0.0], 0.0
    for before, tip in pairwise([tip for tip in tips if tip.t_ns >= stall.end_ns - 50 * MS]):
        if tip.t_ns < stall.end_ns or tip.mode not in ("follow", "hold"):
            continue
        step_nm = 1e9 * (before.base_position_m[2] - tip.base_position_m[2])
        if tip.t_ns <= stall.end_ns + SOON_NS:
            soon.append(soon[-1] + step_nm)
        if commands[tip.command_seq].t_ns < stall.end_ns:
            queued += abs(step_nm)
    return max(soon) - min(soon), queued


def force_ratio(tips: Sequence[Any], begin_ns: int) -> float:
    """Give the greatest force on the tip from a time on, to that before it."""
    before, after = (
        [abs(tip.tip_force_n[2]) for tip in tips if (tip.t_ns < begin_ns) is is_before] for is_before in (True, False)
    )
    return max(after) / max(before)


def reported_s(events: Sequence[Any], stall: Stall) -> float:
    """Give for how long a process says that it was held up [s], 0.0 if it says nothing."""
    own = [e for e in events if e.src == stall.node and stall.end_ns <= e.t_ns <= stall.end_ns + 1000 * MS]
    return max((float(e.data["stalled_s"]) for e in own if "stalled_s" in e.data), default=0.0)


def ways_of(found: Findings) -> str:
    """Give the ages and ways of a session in words."""
    ages = f"command {found.command_ms:.0f} ms, hand's sample {found.hand_ms:.0f}, answer {found.answer_ms:.0f}"
    moved = f"tip moved {found.queued_nm:.2f} nm by what waited, {found.soon_nm:.2f} within 20 ms"
    return f"oldest obeyed: {ages}; {moved}"


def check(findings: Findings) -> None:
    """Check the ages, ways and forces of a session."""
    assert findings.command_ms <= DEADLINE_MS + GRAIN_MS
    assert findings.hand_ms <= DEADLINE_MS + GRAIN_MS
    assert findings.answer_ms <= DEADLINE_MS + GRAIN_MS
    assert findings.soon_nm <= MOST_NM
    assert findings.queued_nm <= MOST_NM
    assert findings.force_ratio <= MOST_FORCE
    for stall, stalled_s in findings.reported_s.items():
        assert stall.node not in NODES or stalled_s >= 0.9 * (stall.end_ns - stall.begin_ns) * 1e-9, stall


@BOTH_WAYS
@pytest.mark.endurance
def test_each_process_of_a_rig_with_a_page_stands_still_for_a_moment(tmp_path: Path, processes: str) -> None:
    """The recorder and the page's server as well; what they keep back is no matter of hand and tip."""
    session = Session(tmp_path, processes)
    with contextlib.ExitStack() as open_parts:
        open_parts.callback(session.rig.close)
        view = open_parts.enter_context(contextlib.closing(View(session.rig.environment)))
        # two swings of the hand that nothing disturbs
        time.sleep(2.0)
        for node in (*NODES, RECORDER, PAGE):
            for duration_s in SHORT_S:
                session.stall(node, duration_s, view.process_id if node == PAGE else None)
                session.arm()
        with urllib.request.urlopen(view.observer, timeout=PATIENCE_S) as answer:
            assert answer.status == 200
        found = session.end()
    check(found)
    record(
        "each process, with recorder and page's server, stopped for 0.05, 0.3 and 2 s under wave, link of 20 ms"
        f"{session.rig.way}",
        f"{ways_of(found)}; the tip bore {found.force_ratio:.2f} times the force of the swings at most",
    )

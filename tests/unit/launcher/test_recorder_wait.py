"""A recorder that has to catch up at the end of a session, in virtual time."""

import msgspec
import pytest
from launcher_bench import SECOND_NS, health, row

from telenano.launcher.recorder_wait import LastMessages, RecorderWait
from telenano.testing import VirtualClock
from telenano.wire.messages import InputHealth, NodeHealth

RECORDER, HAND = "recorder@master", "haptic_node@master"


class Waiting:
    """A wait of which the test makes the reports of the recorder."""

    def __init__(self, *, publishes: bool = True) -> None:
        self.clock = VirtualClock(SECOND_NS)
        self.lines: list[str] = []
        self.wait = RecorderWait(self.clock, RECORDER, lambda node: publishes and node == HAND, self.lines.append)

    def report(self, age_s: float, topic: str = "haptic/state") -> None:
        self.wait.record(health(RECORDER, inputs=(row(topic, HAND, age_s=age_s),)))

    def pass_s(self, seconds: float) -> None:
        self.clock.advance_ns(round(seconds * SECOND_NS))


def test_one_that_keeps_up_is_not_waited_for() -> None:
    waiting = Waiting()
    assert waiting.wait.behind_s() == 0.0
    waiting.report(0.2)
    assert waiting.wait.over()
    # reports come twice a second: their age tells nothing
    waiting.report(5.0, topic="node/health")
    assert waiting.wait.over()
    assert waiting.lines == []


def test_one_that_is_behind_is_waited_for_with_a_line_a_second() -> None:
    waiting = Waiting()
    for age_s in (5.1, 4.8, 2.4, 2.2, 1.2):
        waiting.report(age_s)
        assert not waiting.wait.over()
        waiting.pass_s(0.5)
    waiting.report(0.1)
    assert waiting.wait.over()
    assert [line.partition(", for at most")[0] for line in waiting.lines] == [
        f"waiting for {RECORDER}, which is {behind} s behind" for behind in ("5.1", "2.4", "1.2")
    ]
    assert "for at most 20 s more; Ctrl-C does not wait" in waiting.lines[0]


def test_one_that_does_not_report_writes_nothing_either() -> None:
    waiting = Waiting()
    waiting.report(0.0)
    waiting.pass_s(4.0)
    assert waiting.wait.behind_s() == 4.0
    assert not waiting.wait.over()


def test_a_wait_ends_at_its_limit_or_when_the_user_wants_it() -> None:
    for end in (lambda waiting: waiting.pass_s(20.0), lambda waiting: waiting.wait.skip()):
        waiting = Waiting()
        waiting.report(9.0)
        assert not waiting.wait.over()
        end(waiting)
        assert waiting.wait.over()


def test_what_a_replay_or_a_node_that_has_ended_sent_is_old_without_a_fault_of_the_recorder() -> None:
    waiting = Waiting(publishes=False)
    waiting.report(1e6)
    assert waiting.wait.behind_s() == 0.0


class Ending:
    """A session that ends, two nodes of the other site with a clock of their own, and the way to the recorder."""

    def __init__(self, ahead_s: float = 0.0, way_s: float = 0.05) -> None:
        self.clock = VirtualClock(SECOND_NS, epoch_offset_ns=10**18)
        self.ahead_s, self.way_s = ahead_s, way_s
        self.lines: list[str] = []
        self.alive = {RECORDER, *FAR}
        self.last = LastMessages(self.clock, RECORDER, FAR, self.alive.__contains__, self.lines.append)
        self.recorded_ns: dict[str, int] = {}
        self.uptime_s = 5.0
        self.run(2.0)

    def run(self, seconds: float, backlog_s: float = 0.0) -> bool:
        """Let time pass in which the recorder has what is older than its backlog; return whether the wait is over."""
        for _ in range(round(4.0 * seconds)):
            self.clock.advance_ns(SECOND_NS // 4)
            self.uptime_s += 0.25
            sent_ns = self.clock.now_ns() + round((self.ahead_s - self.way_s) * 1e9)
            for node in FAR:
                if node in self.alive:
                    self.last.record(stamped(node, sent_ns, self.uptime_s))
                    self.recorded_ns[node] = sent_ns - round(backlog_s * 1e9)
            now_ns = self.clock.now_ns()
            rows = (row("node/health", node, age_s=(now_ns - at) * 1e-9) for node, at in self.recorded_ns.items())
            self.last.record(stamped(RECORDER, now_ns, 5.0, *rows))
        return self.ended and self.last.over()

    ended = False

    def end(self) -> bool:
        self.ended = True
        return self.last.over()


FAR = ("afm_node@slave", "controller@slave")


def stamped(node: str, t_ns: int, uptime_s: float, *rows: InputHealth) -> NodeHealth:
    return msgspec.structs.replace(health(node, inputs=rows, uptime_s=uptime_s), t_ns=t_ns)


@pytest.mark.parametrize("ahead_s", [0.0, 37.0, -37.0])
@pytest.mark.parametrize("way_s", [0.0, 0.05, 0.4])
def test_the_last_messages_of_the_other_site_are_waited_for_whatever_its_clock(ahead_s: float, way_s: float) -> None:
    ending = Ending(ahead_s, way_s)
    assert not ending.end()
    # what was under way when the session ended is not its end
    assert not ending.run(0.25)
    assert ending.run(0.25)
    assert ending.last.missing == []
    assert ending.lines == []


def test_a_backlog_on_the_way_to_the_recorder_is_waited_for() -> None:
    ending = Ending()
    assert not ending.end()
    for backlog_s in (4.0, 4.0, 3.0, 3.0, 3.0, 3.0):
        assert not ending.run(0.5, backlog_s)
    assert ending.run(1.0, 0.5)
    assert ending.last.missing == []
    assert ending.lines[0] == (
        "waiting for the last messages of afm_node@slave, controller@slave to reach recorder@master, for at most 19 s "
        "more; Ctrl-C does not wait"
    )


@pytest.mark.parametrize("skip", [False, True])
def test_what_never_comes_is_named(skip: bool) -> None:
    ending = Ending()
    assert not ending.end()
    assert not ending.run(3.0, 4.0)
    if skip:
        ending.last.skip()
        assert ending.last.over()
    else:
        # the backlog grows as fast as time passes
        while not ending.run(0.5, 30.0):
            pass
        assert len(ending.lines) > 15
    behind_s = 4.0 if skip else 30.0
    assert ending.last.missing == [
        f"what {node} sent in the last {behind_s:.1f} s had not reached recorder@master when the wait for it was over"
        for node in FAR
    ]


def test_a_site_that_is_silent_at_the_end_is_named_and_not_waited_for() -> None:
    ending = Ending()
    ending.alive -= set(FAR)
    assert ending.end()
    assert ending.last.missing == [
        f"{node} was silent at the end of the session: what it sent last may be missing" for node in FAR
    ]


def test_a_recorder_that_has_died_is_not_waited_for() -> None:
    ending = Ending()
    ending.alive.remove(RECORDER)
    assert ending.end()
    assert len(ending.last.missing) == 2


def test_a_node_that_was_started_again_with_another_clock_is_waited_for_by_that_one() -> None:
    ending = Ending(ahead_s=-1e6)
    ending.ahead_s, ending.uptime_s = 0.0, 0.0
    ending.run(1.0)
    assert not ending.end()
    assert not ending.run(0.25)
    assert ending.run(0.25)
    assert ending.last.missing == []

"""A recorder that has to catch up before it begins a new file, in virtual time."""

from launcher_bench import SECOND_NS, health, row

from services.launcher.recorder_wait import RecorderWait
from services.runtime.clock import VirtualClock

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

import pytest

from telenano.launcher import restart_policy
from telenano.launcher.restart_policy import RestartTracker, describe_exit
from telenano.testing import VirtualClock

NODE = "afm_node@slave"
SECOND_NS = 1_000_000_000


def tracked() -> tuple[VirtualClock, RestartTracker]:
    clock = VirtualClock(start_ns=SECOND_NS)
    tracker = RestartTracker(clock, [NODE, "recorder@master"])
    tracker.record_start(NODE)
    return clock, tracker


def die_and_come_back(clock: VirtualClock, tracker: RestartTracker, life_s: float) -> float:
    clock.advance_ns(round(life_s * SECOND_NS))
    process_exit = tracker.record_exit(NODE, -9)
    assert process_exit.restart_in_s is not None
    clock.advance_ns(round(process_exit.restart_in_s * SECOND_NS))
    assert tracker.due() == [NODE]
    tracker.record_start(NODE)
    return process_exit.restart_in_s


def test_back_off_doubles_up_to_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart_policy, "CRASH_LOOP_EXITS", 100)
    clock, tracker = tracked()
    delays = [die_and_come_back(clock, tracker, 0.01) for _ in range(9)]
    assert delays == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0]
    assert tracker.restarts(NODE) == 9


def test_a_long_life_resets_the_back_off_and_a_slightly_shorter_one_does_not() -> None:
    clock, tracker = tracked()
    assert die_and_come_back(clock, tracker, 0.01) == 0.1
    assert die_and_come_back(clock, tracker, 9.999) == 0.2
    assert die_and_come_back(clock, tracker, 10.0) == 0.1


def test_it_is_due_at_the_end_of_its_delay_and_not_before() -> None:
    clock, tracker = tracked()
    tracker.record_exit(NODE, -9)
    clock.advance_ns(SECOND_NS // 10 - 1)
    assert tracker.due() == []
    clock.advance_ns(1)
    assert tracker.due() == [NODE]
    tracker.record_start(NODE)
    assert tracker.due() == []


def test_the_fifth_exit_within_the_window_is_a_crash_loop() -> None:
    clock, tracker = tracked()
    for _ in range(4):
        die_and_come_back(clock, tracker, 0.01)
    clock.advance_ns(SECOND_NS)
    process_exit = tracker.record_exit(NODE, 1)
    assert process_exit.given_up
    assert process_exit.exit_code == 1
    assert "5 times within 30 s" in process_exit.verdict
    clock.advance_ns(100 * SECOND_NS)
    assert tracker.due() == []


def test_exits_outside_the_window_do_not_count() -> None:
    clock, tracker = tracked()
    # five exits 7.6 s apart and more: the window of 30 s never holds five
    for _ in range(20):
        die_and_come_back(clock, tracker, 7.6)


def test_bad_configuration_is_not_retried() -> None:
    _, tracker = tracked()
    process_exit = tracker.record_exit(NODE, 2)
    assert process_exit.given_up
    assert "not retried" in process_exit.verdict


@pytest.mark.parametrize(
    ("code", "words"),
    [(0, "exit code 0"), (3, "exit code 3"), (-9, "killed by SIGKILL"), (-11, "SIGSEGV"), (-200, "signal 200")],
)
def test_an_exit_is_described_in_words(code: int, words: str) -> None:
    assert words in describe_exit(code)

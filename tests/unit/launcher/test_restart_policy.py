import pytest

from services.launcher.restart_policy import RestartPolicy, RestartTracker, ending
from services.runtime.clock import VirtualClock

NODE = "afm_node@slave"
SECOND_NS = 1_000_000_000


def supervised(policy: RestartPolicy | None = None) -> tuple[VirtualClock, RestartTracker]:
    clock = VirtualClock(start_ns=SECOND_NS)
    supervisor = RestartTracker(clock, [NODE, "recorder@master"], policy)
    supervisor.started(NODE)
    return clock, supervisor


def die_and_come_back(clock: VirtualClock, supervisor: RestartTracker, life_s: float) -> float:
    clock.advance_ns(round(life_s * SECOND_NS))
    death = supervisor.died(NODE, -9)
    assert death.restart_in_s is not None
    clock.advance_ns(round(death.restart_in_s * SECOND_NS))
    assert supervisor.due() == [NODE]
    supervisor.started(NODE)
    return death.restart_in_s


def test_back_off_doubles_up_to_its_limit() -> None:
    clock, supervisor = supervised(RestartPolicy(crash_loop_deaths=100))
    delays = [die_and_come_back(clock, supervisor, 0.01) for _ in range(9)]
    assert delays == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0]
    assert supervisor.restarts(NODE) == 9


def test_a_long_life_resets_the_back_off_and_a_slightly_shorter_one_does_not() -> None:
    clock, supervisor = supervised()
    assert die_and_come_back(clock, supervisor, 0.01) == 0.1
    assert die_and_come_back(clock, supervisor, 9.999) == 0.2
    assert die_and_come_back(clock, supervisor, 10.0) == 0.1


def test_it_is_due_at_the_end_of_its_delay_and_not_before() -> None:
    clock, supervisor = supervised()
    supervisor.died(NODE, -9)
    clock.advance_ns(SECOND_NS // 10 - 1)
    assert supervisor.due() == []
    clock.advance_ns(1)
    assert supervisor.due() == [NODE]
    supervisor.started(NODE)
    assert supervisor.due() == []


def test_the_fifth_death_within_the_window_is_a_crash_loop() -> None:
    clock, supervisor = supervised()
    for _ in range(4):
        die_and_come_back(clock, supervisor, 0.01)
    clock.advance_ns(SECOND_NS)
    death = supervisor.died(NODE, 1)
    assert death.given_up
    assert death.exit_code == 1
    assert "5 times within 30 s" in death.verdict
    clock.advance_ns(100 * SECOND_NS)
    assert supervisor.due() == []


def test_deaths_outside_the_window_do_not_count() -> None:
    clock, supervisor = supervised()
    # five deaths 7.6 s apart and more: the window of 30 s never holds five
    for _ in range(20):
        die_and_come_back(clock, supervisor, 7.6)


def test_bad_configuration_is_not_retried() -> None:
    _, supervisor = supervised()
    death = supervisor.died(NODE, 2)
    assert death.given_up
    assert "not retried" in death.verdict


@pytest.mark.parametrize(
    ("code", "words"),
    [(0, "exit code 0"), (3, "exit code 3"), (-9, "killed by SIGKILL"), (-11, "SIGSEGV"), (-200, "signal 200")],
)
def test_an_ending_is_said_in_words(code: int, words: str) -> None:
    assert words in ending(code)

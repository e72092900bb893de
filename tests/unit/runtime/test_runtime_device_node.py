"""What comes from a recording stays away from devices, and is not taken for a repetition by readers."""

from types import SimpleNamespace
from typing import Any

import pytest
from recorder_samples import fields_of

from services.afm_node.node import AfmNode
from telenano.afm.sim import simulated_afm
from telenano.runtime.loop.device_node import Parts, StepPart
from telenano.sections.afm_section import AfmConfig
from telenano.wire.messages import SessionEvent
from telenano.wire.sequence import Arrival, SequenceTracker

SECOND_NS = 1_000_000_000
COMMAND = {"mode": "hold", "base_position_m": (0.0, 0.0, 0.0), "hand_seq": 0, "hand_t_ns": 0}
SOURCE = "controller@slave"


@pytest.fixture
def bench(bench_of: Any) -> Any:
    return bench_of("afm_node@slave")


def device_node(bench: Any, *, allow: bool = False) -> AfmNode:
    config = AfmConfig(allow_replay=allow)
    return AfmNode(bench.context, config, simulated_afm(config.to_params()))


def command(bench: Any) -> Any:
    return bench.received("afm/command", SOURCE, **COMMAND)


def control(bench: Any, name: str, src: str = "launcher@master") -> Any:
    return bench.received("session/control", src, id="1", command=name, target="*", parameters={})


def test_commands_of_a_source_marked_replay_are_refused_and_reported_once_until_it_is_live_again(bench: Any) -> None:
    guard = device_node(bench)
    assert guard.admits(command(bench))
    assert guard.admits(bench.received("node/health", SOURCE, **fields_of("node/health", replay=True)))
    assert not any(guard.admits(command(bench)) for _ in range(5))
    # it is reported once
    (event,) = bench.take("session/event")
    assert isinstance(event, SessionEvent)
    assert (event.kind, event.level, event.data["source"]) == ("fault", "warning", SOURCE)
    assert guard.admits(bench.received("afm/command", "controller@master", **COMMAND))
    guard.admits(bench.received("node/health", SOURCE, **fields_of("node/health", replay=False)))
    assert guard.admits(command(bench))


def test_replayed_commands_are_obeyed_where_that_is_allowed(bench: Any) -> None:
    guard = device_node(bench, allow=True)
    guard.admits(bench.received("node/health", SOURCE, **fields_of("node/health", replay=True)))
    assert guard.admits(command(bench))


def test_a_replayed_session_arms_nothing_but_may_stop_everything(bench: Any) -> None:
    guard = device_node(bench)
    guard.admits(bench.received("node/health", "launcher@master", **fields_of("node/health", replay=True)))
    assert not guard.admits(control(bench, "arm"))
    assert guard.admits(control(bench, "estop"))


def test_the_age_of_a_device_is_the_mean_of_an_interval_and_absent_without_samples(bench: Any) -> None:
    node = device_node(bench)
    # the limit of its guard is there without a device
    limit = {"force_limit_n": AfmConfig().safety.force_limit_n}
    assert node.device_health() == limit
    node.has_device(3e-3, "stage 7")
    declared = {"device_latency_s": 3e-3, "calibration": "stage 7", **limit}
    assert node.device_health() == declared
    for status, age_s in (("ok", 0.25), ("lost", 9.0), ("stale", 0.75)):
        node.process_report(SimpleNamespace(status=status, age_s=age_s, text=""))
    assert node.device_health() == declared | {"device_age_s": 0.5}
    assert node.device_health() == declared


def test_what_a_device_says_is_an_event_once(bench: Any) -> None:
    node = device_node(bench)
    assert not node.is_lost
    bench.take("session/event")
    for status, text in (("ok", "ready"), ("ok", "ready"), ("lost", "unplugged"), ("lost", "unplugged")):
        node.process_report(SimpleNamespace(status=status, age_s=0.0, text=text))
    assert node.is_lost
    told = [(event.kind, event.level, event.text) for event in bench.take("session/event")]
    assert told == [("node", "info", "ready"), ("fault", "warning", "unplugged")]


class First(StepPart[int, list[str]]):
    def prepare(self, step: int, memory: list[str]) -> None:
        memory.append(f"first {step}")


class Second(StepPart[int, list[str]]):
    def prepare(self, step: int, memory: list[str]) -> None:
        memory.append(f"second {step}")

    def report(self, step: int, memory: list[str]) -> None:
        memory.append(f"report {step}")


def test_the_parts_of_a_step_act_in_their_order_and_where_they_have_something_to_do() -> None:
    memory: list[str] = []
    parts = Parts([First(), Second()])
    for step, call in enumerate((parts.prepare, parts.measure, parts.report)):
        call(step, memory)
    assert memory == ["first 0", "second 0", "report 2"]


def filled(count: int, t_ns: int = 100 * SECOND_NS) -> SequenceTracker:
    tracker = SequenceTracker()
    for seq in range(count):
        tracker.accept(seq, t_ns + seq)
    return tracker


def test_a_recording_played_after_its_publisher_was_received_is_a_restart() -> None:
    tracker = filled(5000)
    arrivals = [tracker.accept(seq, 5 * SECOND_NS + seq) for seq in range(100)]
    assert arrivals[:7] == [Arrival.DUPLICATE] * 7
    assert arrivals[7] is Arrival.RESTART
    assert set(arrivals[8:]) == {Arrival.NEXT}
    assert (tracker.restarts, tracker.lost) == (1, 0)


def test_repetitions_between_fresh_messages_or_young_ones_are_no_restart() -> None:
    tracker = filled(100)
    for seq in range(100, 200):
        assert tracker.accept(seq, 100 * SECOND_NS + seq) is Arrival.NEXT
        assert tracker.accept(seq, 100 * SECOND_NS + seq) is Arrival.DUPLICATE
        assert tracker.accept(seq - 100, 5 * SECOND_NS) is Arrival.DUPLICATE
    for seq in range(150, 200):
        assert tracker.accept(seq, 100 * SECOND_NS + seq) is Arrival.DUPLICATE
    assert tracker.restarts == 0


def test_a_measured_number_is_no_news_and_the_end_of_a_trouble_is_no_empty_event(bench: Any) -> None:
    node = device_node(bench)
    bench.take("session/event")
    texts = ["", *(f"my_handle has been silent for {ms} ms" for ms in range(60, 140, 4)), "joint 3 is hot: 71.5 V", ""]
    texts += ["joint 4 is hot: 72.5 V", "joint 4 is hot: 73 V", "", ""]
    for text in texts:
        node.process_report(SimpleNamespace(status="lost" if text else "stale", age_s=0.0, text=text), is_late=True)
    told = [(event.kind, event.level, event.text) for event in bench.take("session/event")]
    again = ("node", "info", "the device answers again")
    assert told == [
        ("fault", "warning", "my_handle has been silent for 60 ms"),
        ("fault", "warning", "joint 3 is hot: 71.5 V"),
        again,
        ("fault", "warning", "joint 4 is hot: 72.5 V"),
        again,
    ]

"""The time of a node by part of a hop: each nanosecond is charged to one part, and nothing is left behind."""

import json
import logging

import hop_trace
import pytest
import zmq
from hop_trace import PARTS, HopTrace

from telenano.runtime.bus.bus import Subscriber, ZmqBus
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.log import StructuredLog
from telenano.timing.clock import SystemClock


def test_a_hop_is_divided_into_its_parts() -> None:
    times = iter([0, 10, 11, 13, 16, 20, 25, 31, 38, 46, 55, 65])
    trace = HopTrace(lambda: next(times))
    trace.wake()  # at 10
    trace.begin("take")  # the loop before it: 1
    trace.end()  # 2
    trace.begin("decode")  # the loop: 3
    trace.end()  # 4
    trace.begin("build")  # the step: 5
    trace.begin("send")  # 6
    trace.end()  # 7
    trace.end()  # the rest of build: 8
    trace.wait()  # after: 9
    assert trace.hops == [(2, 4, 1 + 3 + 5, 6 + 8, 7, 9)]
    assert trace.medians_us()["after"] == pytest.approx(0.009)


def test_what_is_between_two_messages_of_a_turn_is_no_delay_of_the_last() -> None:
    times = iter(range(0, 1000, 10))
    trace = HopTrace(lambda: next(times))
    trace.wake()
    for _ in range(2):
        trace.begin("build")
        trace.begin("send")
        trace.end()
        trace.end()
    trace.wait()
    assert dict(zip(PARTS, trace.hops[0], strict=True)) == {
        "take": 0, "decode": 0, "act": 20, "build": 40, "send": 20, "after": 10,
    }  # fmt: skip


def test_a_turn_that_sends_nothing_is_no_hop() -> None:
    trace = HopTrace()
    trace.wake()
    trace.begin("take")
    trace.end()
    trace.wait()
    assert trace.hops == []
    assert trace.medians_us() == {}


def test_the_trace_reports_and_leaves_the_bus_as_it_was(caplog: pytest.LogCaptureFixture) -> None:
    timed = (ZmqBus.wait, Subscriber.receive_raw, Subscriber.take, ZmqPublisher.publish, ZmqPublisher.send)
    clock = SystemClock()
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    with caplog.at_level(logging.INFO):
        report = hop_trace.install(StructuredLog("controller@master"))
        publisher = ZmqPublisher(context, clock, "controller@master", "inproc://trace")
        bus = ZmqBus(publisher, [], clock, -1)
        for _ in range(3):
            bus.wait(0)
            bus.publish("clock/ping")
        bus.wait(0)
        report()
    publisher.close()
    context.destroy()
    (entry,) = caplog.records
    assert entry.facts["hops"] == 3  # type: ignore[attr-defined]
    assert json.loads(json.dumps(entry.facts["parts"]))["send"] > 0.0  # type: ignore[attr-defined]
    assert (ZmqBus.wait, Subscriber.receive_raw, Subscriber.take, ZmqPublisher.publish, ZmqPublisher.send) == timed
    assert "publish" not in vars(ZmqPublisher)

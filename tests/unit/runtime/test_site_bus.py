"""What a process of a site hands over in memory is what its sockets bring, and the wire has all of it as ever."""

import random
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
import zmq

from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.site.site_bus import Exchange, NearReader, SitePublisher
from telenano.timing.clock import SystemClock
from telenano.wire import encode
from telenano.wire.received import Received

HALF, TIP = "controller@slave", "afm_node@slave"
TOPICS = ("clock/pong", "session/event", "link/delay")


@pytest.fixture
def context() -> "Iterator[zmq.Context[zmq.Socket[bytes]]]":
    made: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    yield made
    made.destroy(0)


def _fields(topic: str, number: int) -> dict[str, Any]:
    if topic == "clock/pong":
        return {"ping_t_ns": number, "received_ns": 2 * number}
    if topic == "session/event":
        return {"id": "", "kind": "node", "level": "info", "text": f"number {number}", "data": {"number": number}}
    return {
        "direction": "forward", "delay_ns": number, "hand_t_ns": number, "transit_ns": 0, "clock_ahead_ns": 0,
    }  # fmt: skip


def _facts(received: list[Received]) -> list[tuple[Any, ...]]:
    return [(one.topic, one.message, one.payload, one.arrival) for one in received]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("forwards", [False, True])
def test_memory_brings_what_the_socket_brings(context: Any, seed: int, *, forwards: bool) -> None:
    draws, clock, endpoint = random.Random(seed), SystemClock(), f"ipc://{tempfile.mkdtemp()}/a"
    exchange = Exchange({TIP, HALF})
    memory = NearReader(clock, TOPICS, newest_only=False)
    exchange.connect(HALF, memory, {TIP: TOPICS})
    with (
        closing(SitePublisher(context, clock, TIP, endpoint)) as publisher,
        closing(Subscriber(context, clock, {endpoint: TOPICS})) as reader,
    ):
        publisher.hand_over = exchange.hand_over
        near: list[Received] = []
        far: list[Received] = []
        deadline_s = time.monotonic() + 5.0
        # The first messages find no connection yet, and count for neither.
        while not far and time.monotonic() < deadline_s:
            publisher.publish("clock/pong", **_fields("clock/pong", 0))
            far = reader.receive()
        memory.receive()
        last = publisher.sequence_numbers()["clock/pong"] - 1
        while reader.trackers["clock/pong", TIP].last_seq < last and time.monotonic() < deadline_s:
            reader.receive()
        far = []
        sent = []
        for number in range(draws.randrange(20, 60)):
            topic = draws.choice(TOPICS)
            message = publisher.publish(topic, **_fields(topic, number))
            sent.append((topic, message))
            if forwards and draws.random() < 0.3:
                # Bytes that are sent once more, as they were, are a repetition at either reader.
                publisher.send(topic, encode(message))
            if draws.random() < 0.3:
                near += memory.receive()
        near += memory.receive()
        while len(far) < len(sent) and time.monotonic() < deadline_s:
            far += reader.receive()
        assert [(one.topic, one.message) for one in near] == sent
        assert _facts(near) == _facts(far)
        assert memory.rejected == reader.rejected

from itertools import pairwise

import numpy as np
import pytest

from telenano.link.models.queueing import DeliveryServer, RateServer, ServedQueue, SlotGate, Waiting
from telenano.link.random_streams import stream
from telenano.settings.link_settings import Queue

MS = 1_000_000


def waiting(number, *, topic="a", size=100, ready=0, reliable=False):
    return Waiting(ready, size, topic, reliable, number, number)


def full(limits, *, topics="aaa"):
    """A queue at 1000 byte/s with one message on the line (item 0) and the others waiting."""
    queue = ServedQueue(limits, RateServer(1000.0, 0), stream(1, "queue"))
    for number, topic in enumerate("a" + topics):
        assert queue.push(waiting(number, topic=topic)) == []
        if number == 0:
            queue.pop()
    return queue


def drain(queue):
    items = []
    while queue.leave_ns is not None:
        items.append(queue.pop())
    return items


def test_rate_server_serves_back_to_back_and_counts_the_overhead():
    queue = ServedQueue(Queue(), RateServer(1_000_000.0, 50), stream(1, "queue"))
    for number, ready in enumerate((0, 0, 10_000, 5 * MS)):
        queue.push(waiting(number, size=950, ready=ready))
    # 1000 bytes take 1 ms; the last one finds an idle line.
    assert drain(queue) == [(0, MS), (1, 2 * MS), (2, 3 * MS), (3, 6 * MS)]


def test_waiting_message_leaves_when_its_transmission_starts():
    queue = full(Queue(), topics="a")
    assert queue.leave_ns == 100 * MS
    assert queue.free_ns == 100 * MS
    assert drain(queue) == [(1, 200 * MS)]


@pytest.mark.parametrize(
    ("drop", "topics", "dropped", "left"),
    [
        ("tail", "aba", [9], [1, 2, 3]),
        ("head", "aba", [1], [2, 3, 9]),
        ("same_topic", "aba", [2], [1, 3, 9]),
        ("same_topic", "aaa", [9], [1, 2, 3]),
    ],
)
def test_full_queue_drops_by_its_policy(drop, topics, dropped, left):
    queue = full(Queue(limit_messages=3, drop=drop), topics=topics)
    assert queue.push(waiting(9, topic="b")) == dropped
    assert [item for item, _ in drain(queue)] == left


def test_drop_at_the_head_moves_the_others_forward():
    queue = full(Queue(limit_messages=3, drop="head"))
    queue.push(waiting(9))
    assert drain(queue) == [(2, 200 * MS), (3, 300 * MS), (9, 400 * MS)]


def test_random_drop_hits_all_alike_the_arriving_message_too():
    queue = full(Queue(limit_messages=3, drop="random"))
    hits = dict.fromkeys(range(4), 0)
    held = [1, 2, 3]
    for number in range(10, 20010):
        (victim,) = queue.push(waiting(number))
        hits[[*held, number].index(victim)] += 1
        held = [item for item in [*held, number] if item != victim]
    assert all(abs(count / 20000 - 0.25) < 4 * (0.1875 / 20000) ** 0.5 for count in hits.values())


def test_byte_limit_drops_until_the_arriving_message_fits():
    queue = full(Queue(limit_messages=None, limit_bytes=300, drop="head"))
    assert queue.push(waiting(9, size=150)) == [1, 2]
    assert queue.push(waiting(10, size=301)) == [10]
    assert [item for item, _ in drain(queue)] == [3, 9]


def test_queue_of_length_zero_still_has_a_line():
    queue = ServedQueue(Queue(limit_messages=0), RateServer(1000.0, 0), stream(1, "queue"))
    assert queue.push(waiting(0)) == []
    queue.pop()
    assert queue.push(waiting(1)) == [1]
    assert queue.push(waiting(2, ready=100 * MS)) == []


@pytest.mark.parametrize("drop", ["tail", "head", "random", "same_topic"])
def test_reliable_message_waits_beyond_the_limit_and_is_never_the_victim(drop):
    queue = ServedQueue(Queue(limit_messages=1, drop=drop), RateServer(1000.0, 0), stream(1, "queue"))
    queue.push(waiting(0))
    queue.pop()
    assert queue.push(waiting(1, reliable=True)) == []
    assert queue.push(waiting(2, reliable=True)) == []
    assert queue.push(waiting(3)) == [3]
    assert len(queue) == 2


def brute_force_delivery(times_ns, per_opportunity, messages, cycles):
    """Walk opportunity by opportunity, bytes in hand, serving a first-in first-out list."""
    pending = list(messages)
    done = []
    sent = 0
    for at in (cycle * times_ns[-1] + time for cycle in range(cycles) for time in times_ns):
        budget = per_opportunity
        while pending and pending[0][0] <= at and budget > 0:
            size = pending[0][1]
            part = min(budget, size - sent)
            budget, sent = budget - part, sent + part
            if sent == size:
                done.append(at)
                sent = 0
                pending.pop(0)
    return done


def test_delivery_times_are_exactly_those_of_a_walk_through_the_opportunities():
    generator = np.random.default_rng(4)
    for _ in range(30):
        times = tuple(int(t) for t in np.sort(generator.integers(0, 200, size=12)) + 1)
        ready = np.sort(generator.integers(0, 2000, size=80))
        sizes = generator.integers(1, 700, size=80)
        messages = [(int(r), int(s)) for r, s in zip(ready, sizes, strict=True)]
        queue = ServedQueue(Queue(), DeliveryServer(times, 300, 0), stream(1, "queue"))
        for number, (at, size) in enumerate(messages):
            queue.push(waiting(number, size=size, ready=at))
        assert [finish for _, finish in drain(queue)] == brute_force_delivery(times, 300, messages, 400)


def test_delivery_without_byte_limit_is_one_message_per_opportunity():
    queue = ServedQueue(Queue(), DeliveryServer((2, 5, 5, 10), None, 100), stream(1, "queue"))
    for number, ready in enumerate((100, 101, 102, 103, 103, 151)):
        queue.push(waiting(number, size=99999, ready=ready))
    assert [finish for _, finish in drain(queue)] == [102, 105, 105, 110, 112, 152]


def test_message_that_arrives_with_an_opportunity_takes_it():
    queue = ServedQueue(Queue(), DeliveryServer((0, 10), 1500, 0), stream(1, "queue"))
    for number, ready in enumerate((0, 10, 20)):
        queue.push(waiting(number, size=1500, ready=ready))
    # Time 10 is the end of the first cycle and the start of the second: two opportunities.
    assert [finish for _, finish in drain(queue)] == [0, 10, 20]


def test_server_can_be_kept_busy():
    rate, delivery = RateServer(1000.0, 0), DeliveryServer((10, 20), 1500, 0)
    for server in (rate, delivery):
        server.wait_until(55)
    assert rate.passage(0, 1).leave_ns == 55
    assert delivery.passage(0, 1).finish_ns == 60


def test_slots_at_a_fixed_distance_group_what_comes_between():
    gate = SlotGate((10, 10), None, None, 100, stream(1, "slots"))
    assert [gate.slot_ns(100, t, 1) for t in (100, 101, 109, 110, 111, 205)] == [100, 110, 110, 110, 120, 210]


def test_slot_is_limited_in_messages_and_bytes():
    gate = SlotGate((10, 10), 2, None, 0, stream(1, "slots"))
    assert [gate.slot_ns(1, 1, 1) for _ in range(5)] == [10, 10, 20, 20, 30]
    gate = SlotGate((10, 10), None, 100, 0, stream(1, "slots"))
    # The third does not fit, the fourth still does, the fifth is larger than any slot and gets one alone.
    assert [gate.slot_ns(1, 1, size) for size in (40, 40, 40, 20, 500, 70)] == [10, 10, 20, 10, 30, 40]


def test_random_slots_have_uniform_distances_and_bounded_memory():
    gate = SlotGate((5 * MS, 15 * MS), None, None, 0, stream(1, "slots"))
    slots = [gate.slot_ns(t, t, 1) for t in range(0, 100_000 * MS, MS)]
    assert all(slot >= t for slot, t in zip(slots, range(0, 100_000 * MS, MS), strict=True))
    distances = np.array([b - a for a, b in pairwise(sorted(set(slots)))]) / MS
    assert distances.min() >= 5.0
    assert distances.max() <= 15.0
    assert abs(distances.mean() - 10.0) < 4 * 10 / 12**0.5 / len(distances) ** 0.5
    assert abs((distances < 7.5).mean() - 0.25) < 4 * (0.1875 / len(distances)) ** 0.5
    assert len(gate.state.times_ns) < 6000


def test_a_long_pause_between_slots_is_not_walked_through():
    draws = []
    gate = SlotGate((1000, 3000), None, None, 0, lambda: draws.append(0) or 0.5)
    hour_ns = 3600 * 10**9
    assert hour_ns <= gate.slot_ns(hour_ns, hour_ns, 100) <= hour_ns + 3000
    assert len(draws) < 10
    # up to some twenty thousand it is: the slots of a session do not depend on when messages come
    slots = [SlotGate((1000, 3000), None, None, 0, stream(5, "slots")) for _ in range(2)]
    for release_ns in range(0, 10_000_000, 1_000_000):
        slots[0].slot_ns(release_ns, release_ns, 100)
    assert slots[0].slot_ns(10_000_000, 10_000_000, 1) == slots[1].slot_ns(10_000_000, 10_000_000, 1)


def test_a_message_of_many_opportunities_costs_one_division():
    # a million opportunities of one byte each
    server = DeliveryServer((0, 10), 1, 0)
    assert server.send(0, 1_000_000) == server.passage(0, 0).finish_ns
    walked = DeliveryServer((0, 10), 1, 0)
    for _ in range(1000):
        last = walked.send(0, 1)
    assert DeliveryServer((0, 10), 1, 0).send(0, 1000) == last

"""The state of the engine: what was captured in the middle of a session goes on as the engine itself does."""

import random
from types import SimpleNamespace
from typing import Any

import pytest

from telenano.link.engine import LinkEngine, LinkState
from telenano.link.random_streams import stream
from telenano.settings.link_settings import LinkSettings
from telenano.wire.node_state import pack, restore

MS = 1_000_000
START = 1_700_000_000_000_000_000
SOURCES = (("teleop/forward", "controller@master"), ("session/control", "launcher@master"), ("law/status", "a@b"))
QUEUE = {"rate": {"rate_bytes_per_s": 5e5}, "queue": {"limit_messages": 6}}

MODELS: dict[str, dict[str, Any]] = {
    "clean": {},
    "constant": {"delay_s": 0.01},
    "jitter": {"delay_s": 0.01, "jitter": {"scale_s": 0.004, "correlation": 0.9}, "order": "topic"},
    "lasting jitter": {"delay_s": 0.01, "jitter": {"scale_s": 0.004, "correlation_time_s": 0.02}, "order": "topic"},
    "jitter of two times": {
        "delay_s": 0.01,
        "jitter": {
            "scale_s": 0.004,
            "correlation_time_s": 0.02,
            "second_correlation_time_s": 0.003,
            "second_correlation_share": 0.4,
        },
        "duplication": {"probability": 0.2},
    },
    "log-normal stalls": {"outage": {"mean_up_s": 0.03, "mean_down_s": 0.02, "down_spread": 0.4, "mode": "hold"}},
    "loss": {"loss": {"probability": 0.3, "correlation": 0.8}, "apply_probability": 0.8},
    "markov_loss": {"markov_loss": {"p13": 0.2, "p31": 0.3, "p32": 0.3, "p23": 0.4, "p14": 0.1}},
    "gilbert_elliott": {"gilbert_elliott": {"p": 0.1, "r": 0.2, "loss_in_bad": 0.8, "loss_in_good": 0.1}},
    "corruption": {"delay_s": 0.01, "corruption": {"probability": 0.5, "bits": 3}},
    "duplication": {"jitter": {"scale_s": 0.01}, "duplication": {"probability": 0.4}},
    "reordering": {"delay_s": 0.02, "reordering": {"probability": 0.3, "gap": 4}},
    "rate": {**QUEUE, "delay_s": 0.005, "order": "link"},
    "rate_random_drop": {"rate": QUEUE["rate"], "queue": {"limit_bytes": 900, "drop": "random"}},
    "rate_corruption": {
        **QUEUE,
        "corruption": {"probability": 0.5},
        "topics": {"law/*": {"rate": {"overhead_bytes": 9}}},
    },
    "delivery": {"delivery_trace": {"file": "delivery.txt", "bytes_per_opportunity": 400}},
    "delay_trace": {"delay_trace": {"file": "course.txt"}},
    "by_number": {
        "delay_trace": {"file": "numbers.txt", "by": "number"},
        "loss_trace": {"file": "numbered_losses.txt", "by": "number"},
    },
    "outage_session": {"outage": {"schedule": [[0.01, 0.02]], "period_s": 0.05, "origin": "session"}},
    "loss_trace": {"loss_trace": {"file": "losses.txt"}, "delay_s": 0.003},
    "slots": {"slots": {"min_interval_s": 0.002, "max_interval_s": 0.009, "max_messages": 4, "max_bytes": 900}},
    "outage": {"outage": {"mean_up_s": 0.03, "mean_down_s": 0.02, "mode": "hold"}},
    "outage_schedule": {"outage": {"schedule": [[0.01, 0.02]], "period_s": 0.05}, "delay_s": 0.004},
}


class Traffic:
    """Messages of three publishers, one after the other, the same for every engine that they are given to."""

    def __init__(self, count: int) -> None:
        draw = random.Random(5)
        self.messages = []
        self.payloads: dict[tuple[str, str, int], bytes] = {}
        now_ns = START
        for seq in range(count):
            now_ns += draw.randrange(1_200_000)
            topic, src = SOURCES[draw.randrange(3)]
            payload = draw.randbytes(draw.randrange(1, 400))
            self.payloads[topic, src, seq] = payload
            self.messages.append((now_ns, topic, payload, seq, src))

    def find(self, topic: str, src: str, seq: int, arrived_ns: int, size_bytes: int) -> bytes:
        payload = self.payloads[topic, src, seq]
        assert len(payload) == size_bytes
        return payload


class Holder:
    """A node that is nothing but an engine."""

    state_kind, state_version = LinkState, 1
    context = SimpleNamespace(key="delay_node@master")

    def __init__(self, link: LinkEngine) -> None:
        self.capture, self.restore = link.capture, link.restore


def packed(link: LinkEngine) -> bytes:
    return pack(Holder(link))


def give(link: LinkEngine, messages: list[Any]) -> list[Any]:
    """Submit messages to both directions and return what comes out forward, message by message."""
    released = []
    for message in messages:
        released.append(list(link.forward.submit(*message)))
        link.backward.submit(*message)
    return released


@pytest.mark.parametrize("change", [None, {"forward.delay_s": 0.003}, {"forward.loss.probability": 0.1, "seed": 9}])
@pytest.mark.parametrize("models", MODELS)
def test_an_engine_goes_on_from_a_captured_state(tmp_path: Any, models: str, change: dict[str, Any] | None) -> None:
    (tmp_path / "course.txt").write_text("0 0.001\n0.02 0.006\n0.05 0.002\n")
    (tmp_path / "numbers.txt").write_text("0 0.001\n3 0.004\n11 0.002\n")
    (tmp_path / "numbered_losses.txt").write_text("0 0\n4 1\n5 0\n7 0\n")
    (tmp_path / "losses.txt").write_text("0 0\n0.01 1\n0.014 0\n0.04 0\n")
    (tmp_path / "delivery.txt").write_text("1\n3\n4\n9\n")
    settings = LinkSettings.of({"seed": 3, "forward": MODELS[models]})
    traffic = Traffic(200)
    link = LinkEngine(settings, START, folder=tmp_path)
    released: list[Any] = []
    states: dict[int, bytes] = {}
    for place, message in enumerate(traffic.messages):
        if place == 100 and change is not None:
            link.reconfigure(link.settings.changed(change), message[0])
        if place % 40 == 20:
            states[place] = packed(link)
        released += give(link, [message])
    assert sum(map(len, released)) > 50
    stats, fates, last = link.forward.stats(), link.take_fates(), packed(link)
    for place, state in states.items():
        # built as the node builds it for a re-run: at another time, with the settings of the scenario
        other = LinkEngine(settings, START + 10**9, folder=tmp_path)
        restore(Holder(other), state, traffic.find)
        assert give(other, traffic.messages[place:100]) == released[place:100]
        if place <= 100 and change is not None:
            other.reconfigure(other.settings.changed(change), traffic.messages[100][0])
        assert give(other, traffic.messages[max(place, 100) :]) == released[max(place, 100) :]
        assert other.settings == link.settings
        assert other.forward.stats() == stats
        assert other.take_fates() == fates
        assert packed(other) == last


def test_a_message_that_waits_under_former_settings_has_no_form_until_it_has_gone() -> None:
    link = LinkEngine(LinkSettings.of({"forward": {"rate": {"rate_bytes_per_s": 1e5}}}), START)
    for seq in range(4):
        link.forward.submit(START, "teleop/forward", bytes(100), seq)
    link.reconfigure(link.settings.changed({"forward.delay_s": 0.001}), START)
    assert link.capture()
    link.reconfigure(link.settings.changed({"forward.order": "topic"}), START)
    with pytest.raises(ValueError, match="a message on teleop/forward waits under an order or slots"):
        link.capture()
    link.forward.due(START + 10 * MS)
    assert link.capture()


def test_what_has_left_its_queue_at_a_change_is_decided_under_the_former_settings() -> None:
    link = LinkEngine(LinkSettings.of({"forward": {"rate": {"rate_bytes_per_s": 1e5}}}), START)
    for seq in range(4):
        link.forward.submit(START, "teleop/forward", bytes(100), seq)
    # the change is the first call since the last one has left, after 4 ms
    link.reconfigure(link.settings.changed({"forward.order": "topic"}), START + 10 * MS)
    assert link.capture()
    assert [fate.release_ns for fate in link.take_fates()] == [START + n * MS for n in (1, 2, 3, 4)]


def test_the_state_has_the_names_of_what_is_in_flight_and_the_bytes_only_where_bits_were_flipped() -> None:
    for probability in (0.0, 1.0):
        tree = {"delay_s": 1.0, "corruption": {"probability": probability}}
        link = LinkEngine(LinkSettings.of({"forward": tree}), START)
        give(link, [(START + seq, "teleop/forward", bytes(5000), seq, "a@b") for seq in range(10)])
        assert (len(packed(link)) > 50_000) == (probability == 1.0)


def test_a_model_that_was_switched_off_starts_anew() -> None:
    """So a model is what the settings in force and the messages since then make of it, and a state can have all."""
    link = LinkEngine(LinkSettings.of({"forward": {"outage": {"schedule": [[0.0, 0.01]]}}}), START)
    assert not link.forward.submit(START + MS, "a", b"1", 0)
    link.reconfigure(link.settings.changed({"forward.outage.schedule": ""}), START + 20 * MS)
    assert link.forward.submit(START + 21 * MS, "a", b"1", 1)
    link.reconfigure(link.settings.changed({"forward.outage.schedule": "0:0.01"}), START + 30 * MS)
    assert not link.forward.submit(START + 31 * MS, "a", b"1", 2)


def test_a_stream_is_advanced_to_a_count() -> None:
    first, second = stream(7, "a"), stream(7, "a")
    numbers = [first() for _ in range(20)]
    second.advance_to(12)
    assert [second() for _ in range(8)] == numbers[12:]
    assert second.drawn == first.drawn == 20
    with pytest.raises(ValueError, match="20 numbers have been drawn already"):
        second.advance_to(19)

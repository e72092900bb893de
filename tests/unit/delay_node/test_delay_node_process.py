"""The link as a node: what it forwards and when, what it reports of it, what it refuses, and the other site's clock."""

from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest
from recorder_samples import fields_of

from services.afm_node.node import AfmNode
from services.delay_node.node import DelayNode
from telenano.afm.sim import simulated_afm
from telenano.sections.afm_section import AfmConfig
from telenano.settings.link_settings import LinkSettings
from telenano.timing.freshness import Freshness
from telenano.wire import decode, encode
from telenano.wire.ends import read_end
from telenano.wire.errors import RefusedError
from telenano.wire.messages import Message

HALF = fields_of("teleop/forward", hand_t_ns=1)


class SiteEndpoint:
    """The socket towards a site, which keeps what it is given."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        self.sent: list[tuple[str, bytes]] = []

    def send(self, topic: str, payload: bytes) -> None:
        self.sent.append((topic, payload))

    def publish(self, topic: str, **fields: object) -> Message:
        message: Message = self.bench.make(topic, "delay_node@slave", **fields)
        self.send(topic, encode(message))
        return message

    def sequence_numbers(self) -> dict[str, int]:
        topics = [topic for topic, _ in self.sent if not topic.startswith("teleop/")]
        return {topic: topics.count(topic) for topic in topics}


class Link:
    """A link on a bench with an outlet at each site."""

    def __init__(self, bench: Any, settings: LinkSettings, *, spans_machines: bool = False) -> None:
        self.bench = bench
        self.to_slave, self.to_master = SiteEndpoint(bench), SiteEndpoint(bench)
        files = Path()
        self.node = DelayNode(
            bench.context, settings, self.to_slave, self.to_master, files, spans_machines=spans_machines
        )

    def receive(self, topic: str, src: str, **fields: Any) -> bytes:
        received = self.bench.received(topic, src, **fields)
        self.node.on_message(received)
        return bytes(received.payload)

    def pass_ms(self, duration_ms: float) -> None:
        """Let time pass as the loop does: to each deadline in turn."""
        clock = self.bench.clock
        end = clock.monotonic_ns() + round(duration_ms * 1e6)
        while self.node.deadline_ns() <= end:
            clock.advance_ns(max(0, self.node.deadline_ns() - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())
            self.bench.run_deferred()
        clock.advance_ns(end - clock.monotonic_ns())

    def delivered(self, outlet: SiteEndpoint) -> list[bytes]:
        return [payload for topic, payload in outlet.sent if topic.startswith("teleop/")]


@pytest.fixture
def link_of(bench_of: Any) -> Any:
    return lambda **tree: Link(bench_of("delay_node@master"), LinkSettings.of(tree))


def test_clean_link_sends_the_very_bytes_at_once(link_of: Any) -> None:
    link = link_of()
    payload = link.receive("teleop/forward", "controller@master", **HALF)
    assert link.delivered(link.to_slave) == [payload]
    assert link.delivered(link.to_master) == []


def test_each_direction_has_its_delay(link_of: Any) -> None:
    link = link_of(forward={"delay_s": 0.020}, backward={"delay_s": 0.005})
    there = link.receive("teleop/forward", "controller@master", **HALF)
    known = {"separation_m": 0.0, "separation_valid": False, "in_contact": False}
    back = link.receive("teleop/backward", "controller@slave", **HALF, **known)
    link.pass_ms(4.999)
    assert link.delivered(link.to_master) == []
    link.pass_ms(0.002)
    assert link.delivered(link.to_master) == [back]
    assert link.delivered(link.to_slave) == []
    link.pass_ms(15.0)
    assert link.delivered(link.to_slave) == [there]


def test_ground_truth_of_every_message_is_published(link_of: Any) -> None:
    link = link_of(seed=3, forward={"delay_s": 0.002, "topics": {"teleop/*": {"loss": {"probability": 0.5}}}})
    for _ in range(200):
        link.receive("teleop/forward", "controller@master", **HALF)
        link.pass_ms(1.0)
    link.pass_ms(200.0)
    fates = [fate for message in link.bench.take("link/fates") for fate in message.fates]
    assert [fate.seq for fate in fates] == list(range(200))
    lost = [fate for fate in fates if fate.dropped]
    assert {fate.dropped for fate in lost} == {"loss"}
    assert {fate.delay_ns for fate in fates if not fate.dropped} == {2_000_000}
    assert len(link.delivered(link.to_slave)) == 200 - len(lost)


def test_status_has_settings_and_figures(link_of: Any) -> None:
    link = link_of(forward={"delay_s": 0.010})
    for _ in range(50):
        link.receive("teleop/forward", "controller@master", **HALF)
        link.pass_ms(1.0)
    link.pass_ms(100.0)
    status = link.bench.take("link/status")[-1]
    assert status.forward.settings["delay_s"] == 0.010
    assert (status.forward.messages_in, status.forward.messages_out) == (50, 50)
    assert status.forward.delay_mean_s == pytest.approx(0.010, rel=1e-9, abs=0.0)
    assert not status.backward.delay_valid


def control(link: Link, **parameters: Any) -> Any:
    fields = {"id": "a", "command": "set", "target": "delay_node", "parameters": parameters}
    return link.bench.make("session/control", "console@master", **fields)


def test_settings_change_for_what_comes_after(link_of: Any) -> None:
    link = link_of(forward={"delay_s": 0.010})
    first = link.receive("teleop/forward", "controller@master", **HALF)
    link.node.on_control(control(link, **{"forward.delay_s": 0.001}))
    second = link.receive("teleop/forward", "controller@master", **HALF)
    link.pass_ms(2.0)
    assert link.delivered(link.to_slave) == [second]
    link.pass_ms(9.0)
    assert link.delivered(link.to_slave) == [second, first]


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"forward.delay_s": -0.1}, "forward.delay_s"),
        ({"backward.loss.probability": 1.5}, "backward.loss.probability"),
        ({"profile": "lunar"}, "lunar"),
        ({"forward.delya_s": 0.1}, "delya_s"),
        ({}, "needs link settings"),
    ],
)
def test_bad_settings_are_refused_and_the_last_good_ones_stay(link_of: Any, parameters: Any, text: str) -> None:
    link = link_of(forward={"delay_s": 0.010})
    before = link.node.engine.settings
    with pytest.raises(RefusedError, match=text):
        link.node.on_control(control(link, **parameters))
    assert link.node.engine.settings == before


def test_more_settings_of_single_topics_than_a_turn_may_take_are_refused_with_their_number(link_of: Any) -> None:
    link = link_of()

    def topics(count: int, way: str = "forward") -> dict[str, float]:
        return {f"{way}.topics.own/{n}.delay_s": 0.001 for n in range(count)}

    assert link.node.on_control(control(link, **topics(250))).startswith("set forward.topics.own/0")
    for more in (topics(1, "backward"), {**topics(251), "profile": "clean"}):
        with pytest.raises(RefusedError, match=r"^topics: with 251 settings .* a running link takes 250, and one that"):
            link.node.on_control(control(link, **more))
    assert len(link.node.engine.settings.forward.topics) == 250
    link.node.on_control(control(link, **topics(3), profile="clean"))
    assert len(link.node.engine.settings.forward.topics) == 3


@pytest.mark.parametrize(("there_ms", "back_ms"), [(0.2, 0.2), (8.0, 2.0)])
def test_offset_of_the_other_clock_is_measured_with_its_uncertainty(
    bench_of: Any, there_ms: float, back_ms: float
) -> None:
    injected_ns = 750_000_000
    link = Link(bench_of("delay_node@master"), LinkSettings(), spans_machines=True)
    far = bench_of("afm_node@slave")
    config = AfmConfig()
    instrument = AfmNode(far.context, config, simulated_afm(config.to_params()))
    far.clock.epoch_offset_ns += injected_ns + link.bench.clock.monotonic_ns() - far.clock.monotonic_ns()
    skew = far.clock.monotonic_ns() - link.bench.clock.monotonic_ns()
    for _ in range(3):
        link.pass_ms(100.0)
        ping = next(payload for topic, payload in reversed(link.to_slave.sent) if topic == "clock/ping")
        link.bench.advance_ms(there_ms)
        far.clock.advance_ns(link.bench.clock.monotonic_ns() + skew - far.clock.monotonic_ns())
        question = far.received("clock/ping", "delay_node@slave")
        stamp = int(_field(ping, "t_ns"))
        instrument.on_message(_with_stamp(question, stamp))
        (pong,) = far.take("clock/pong")
        link.bench.advance_ms(back_ms)
        answer = {"ping_t_ns": pong.ping_t_ns, "received_ns": pong.received_ns}
        received = link.bench.received("clock/pong", "afm_node@slave", **answer)
        link.node.on_message(_with_stamp(received, pong.t_ns))
    link.pass_ms(100.0)
    clock = link.bench.take("link/status")[-1].clock
    assert clock.valid
    assert clock.round_trip_s == pytest.approx((there_ms + back_ms) * 1e-3, rel=1e-6, abs=0.0)
    expected_s = injected_ns * 1e-9 + 0.5e-3 * (there_ms - back_ms)
    assert clock.offset_s == pytest.approx(expected_s, rel=1e-6, abs=0.0)
    assert abs(clock.offset_s - injected_ns * 1e-9) <= clock.uncertainty_s
    # so a message on the shortest way seems as old as half the round trip, whatever the way back takes
    told = declared(link.to_slave)[-1]
    assert told["transit_ns"] == pytest.approx(0.5e6 * (there_ms + back_ms), rel=1e-6, abs=0.0)
    arrives_ns = injected_ns + round(there_ms * 1e6)
    assert arrives_ns - told["clock_ahead_ns"] == pytest.approx(told["transit_ns"], rel=1e-6, abs=0.0)


def declared(outlet: SiteEndpoint) -> list[dict[str, Any]]:
    return [msgpack.unpackb(payload) for topic, payload in outlet.sent if topic == "link/delay"]


def pairs(outlet: SiteEndpoint) -> list[tuple[str, int, int, int]]:
    return [(row["direction"], row["hand_t_ns"], row["delay_ns"], row["clock_ahead_ns"]) for row in declared(outlet)]


def forward(link: Link, hand_t_ns: int) -> None:
    link.receive("teleop/forward", "controller@master", **{**HALF, "hand_t_ns": hand_t_ns})


def test_a_plain_bridge_tells_its_delay_with_its_status_and_costs_no_message(link_of: Any) -> None:
    link = link_of()
    for n in range(50):
        forward(link, n)
    assert declared(link.to_slave) == declared(link.to_master) == []
    link.pass_ms(250.0)
    assert pairs(link.to_slave) == [("forward", 0, 0, 0)] * 2
    assert pairs(link.to_master) == [("forward", 0, 0, 0), ("backward", 0, 0, 0)] * 2


def test_between_machines_the_slaves_site_is_told_nothing_before_the_clocks_are_known(bench_of: Any) -> None:
    link = Link(bench_of("delay_node@master"), LinkSettings(), spans_machines=True)
    link.pass_ms(250.0)
    forward(link, 1)
    assert declared(link.to_slave) == []
    assert pairs(link.to_master)
    # The clock of the slave is 200 ms behind, and each way takes 10 ms: the first answer is enough to tell it at once.
    now_ns, ahead_ns = link.bench.clock.now_ns(), -200_000_000
    stamp_ns = now_ns - 10_000_000 + ahead_ns
    times = {"ping_t_ns": now_ns - 20_000_000, "received_ns": stamp_ns}
    link.node.on_message(_with_stamp(link.bench.received("clock/pong", "afm_node@slave", **times), stamp_ns))
    assert pairs(link.to_slave) == [("forward", 0, 0, ahead_ns)]


def test_a_delay_is_told_before_the_first_message_that_it_applies_to(link_of: Any) -> None:
    link = link_of(forward={"delay_s": 0.0202}, backward={"delay_s": 0.005})
    known = {"separation_m": 0.0, "separation_valid": False, "in_contact": False}
    for n in range(30):
        forward(link, 1000 + n)
        link.receive("teleop/backward", "controller@slave", **{**HALF, "hand_t_ns": 500 + n}, **known)
        link.pass_ms(1.0)
    # in whole milliseconds, rounded down, and once
    topics = [topic for topic, _ in link.to_slave.sent]
    assert topics.index("link/delay") == topics.index("teleop/forward") - 1
    assert pairs(link.to_slave) == [("forward", 1000, 20_000_000, 0)]
    # the master adds up both ways: it is told of both
    assert sorted(pairs(link.to_master)) == [("backward", 500, 5_000_000, 0), ("forward", 1000, 20_000_000, 0)]
    link.node.on_control(control(link, **{"forward.delay_s": 0.001}))
    forward(link, 2000)
    link.pass_ms(5.0)
    assert pairs(link.to_slave)[-1] == ("forward", 2000, 1_000_000, 0)


def test_with_jitter_every_message_that_a_reader_takes_has_its_delay_told(link_of: Any) -> None:
    jitter = {"scale_s": 0.02, "distribution": "uniform"}
    link = link_of(seed=5, forward={"delay_s": 0.030, "jitter": jitter, "duplication": {"probability": 0.1}})
    for _ in range(400):
        forward(link, link.bench.clock.now_ns())
        link.pass_ms(1.0)
    link.pass_ms(160.0)
    # of two copies the reader takes the first
    delays: dict[int, int] = {}
    for told in link.bench.take("link/fates"):
        for fate in told.fates:
            delays[fate.seq] = min(fate.delay_ns, delays.get(fate.seq, fate.delay_ns))
    age, newest, taken = Freshness("controller@slave", 0), -1, 0
    for topic, payload in link.to_slave.sent:
        message: Any = decode(topic, payload)
        if topic == "link/delay":
            age.record(message)
        elif topic == "teleop/forward" and message.seq > newest:
            newest, taken = message.seq, taken + 1
            assert 0 <= delays[message.seq] - age.lag_ns(message.hand_t_ns) < 1_000_000
    assert 50 < taken < 300


def test_a_link_that_stalled_says_so_and_sends_on_what_waited(link_of: Any) -> None:
    link = link_of(forward={"delay_s": 0.002})
    for n in range(20):
        forward(link, n)
        link.pass_ms(1.0)
    link.bench.advance_ms(1000.0)
    link.node.on_deadline(link.bench.clock.monotonic_ns())
    said = [event for event in link.bench.take("session/event") if event.kind == "fault"]
    assert [event.text for event in said] == ["this process stalled for 1000 ms: messages that waited for it are late"]
    assert len(link.delivered(link.to_slave)) == 20
    # what it took too long for is not told as a delay of the link
    assert {delay_ns for _, _, delay_ns, _ in pairs(link.to_slave)} == {2_000_000}


def _field(payload: bytes, key: str) -> Any:
    return msgpack.unpackb(payload)[key]


def _with_stamp(received: Any, t_ns: int) -> Any:
    return received._replace(message=msgspec.structs.replace(received.message, t_ns=t_ns))


def test_at_its_end_the_link_counts_what_it_has_sent_on_at_each_site(link_of: Any) -> None:
    link = link_of(forward={"delay_s": 0.01})
    for _ in range(3):
        link.receive("teleop/forward", "controller@master", **HALF)
        link.pass_ms(6)
    link.receive(
        "teleop/backward", "controller@slave", **HALF, separation_m=0.0, separation_valid=False, in_contact=False
    )
    link.node.publish_end(link.to_master)
    at_slave, at_master = (read_end(decoded(outlet)) for outlet in (link.to_slave, link.to_master))
    # the third message is in flight, and never left
    assert at_slave is not None and at_slave["teleop/forward", "controller@master"] == 2
    assert at_slave["session/event", "delay_node@slave"] == 1
    assert at_master is not None and at_master["teleop/backward", "controller@slave"] == 1


def decoded(outlet: SiteEndpoint) -> dict[str, Any]:
    fields: dict[str, Any] = msgpack.unpackb(outlet.sent[-1][1])
    return fields


def test_outages_in_session_time_count_from_the_start_command_and_its_repetitions_change_nothing(link_of: Any) -> None:
    link = link_of(forward={"outage": {"schedule": [[1.0, 0.5]], "origin": "session"}})

    def start(identifier: str) -> None:
        fields = {"id": identifier, "command": "start", "target": "*", "parameters": {}}
        link.node.on_message(link.bench.received("session/control", "launcher@master", **fields))

    def is_lost() -> bool:
        before = len(link.delivered(link.to_slave))
        link.receive("teleop/forward", "controller@master", **HALF)
        link.pass_ms(1.0)
        return len(link.delivered(link.to_slave)) == before

    found = []
    for tenth in range(60):
        if tenth in (20, 21, 24, 45):
            start("second" if tenth == 45 else "first")
        found.append(is_lost())
        link.pass_ms(99.0)
    assert [tenth for tenth, lost in enumerate(found) if lost] == [*range(30, 35), *range(55, 60)]


def test_an_emergency_stop_goes_through_at_once_whatever_the_link_does_and_what_waits_goes_on_waiting(
    link_of: Any,
) -> None:
    stall = {"schedule": [[0.0, 5.0]], "mode": "hold"}
    link = link_of(forward={"outage": stall, "delay_s": 0.3, "order": "link", "queue": {"limit_messages": 3}})
    for _ in range(9):
        link.receive("teleop/forward", "controller@master", **HALF)
    control = fields_of("session/control", target="*", parameters={}, command="arm", id="before")
    waiting = link.receive("session/control", "console@master", **control)
    assert link.to_slave.sent == []
    stop = link.receive("session/control", "console@master", **{**control, "command": "estop", "id": "stop"})
    assert link.to_slave.sent == [("session/control", stop)]
    link.pass_ms(150)
    ack = {"id": "stop", "kind": "ack", "level": "info", "text": "stopped", "data": {"command": "estop"}}
    link.receive("session/event", "afm_node@slave", **ack)
    link.pass_ms(4850)
    sent = [payload for topic, payload in link.to_slave.sent if topic == "session/control"]
    assert sent == [stop]
    link.pass_ms(400)
    sent = [payload for topic, payload in link.to_slave.sent if topic == "session/control"]
    assert sent == [stop, waiting]
    assert len(link.delivered(link.to_slave)) == 3


def test_a_stop_that_is_not_obeyed_is_sent_again_and_holds_back_the_hand_and_wishes_to_move(link_of: Any) -> None:
    link = link_of(forward={"delay_s": 0.3})
    control = fields_of("session/control", target="*", parameters={}, command="arm", id="before")
    link.receive("session/control", "console@master", **control)
    stop = link.receive("session/control", "console@master", **{**control, "command": "estop", "id": "stop"})
    for number in range(10):
        link.receive("teleop/forward", "controller@master", **HALF)
        link.receive("session/control", "console@master", **{**control, "id": f"arm{number}"})
        program = {"command": "set", "target": "afm_node", "parameters": {"program": "scan"}}
        link.receive("session/control", "console@master", **{**control, **program, "id": f"scan{number}"})
        link.pass_ms(100)
    link.receive("session/control", "console@master", **{**control, "command": "stop", "id": "end"})
    link.pass_ms(400)
    sent = [payload for topic, payload in link.to_slave.sent if topic == "session/control"]
    assert sent[0] == stop
    # copies with numbers and times of their own, and what moves nothing
    found: list[Any] = [decode("session/control", payload) for payload in sent]
    assert {(message.command, message.id) for message in found} == {("estop", "stop"), ("stop", "end")}
    copies = [message for message in found[1:] if message.command == "estop"]
    assert [message.seq for message in copies] == list(range(len(copies)))
    assert len(copies) == 7
    assert link.delivered(link.to_slave) == []
    fates = [fate for message in link.bench.take("link/fates") for fate in message.fates]
    assert {fate.dropped for fate in fates if fate.topic == "teleop/forward"} == {"stop"}
    # a stop of another id is no answer to this one
    ack = {"kind": "ack", "level": "info", "text": "stopped", "data": {"command": "estop"}}
    link.receive("session/event", "afm_node@slave", **ack, id="another")
    link.receive("teleop/forward", "controller@master", **HALF)
    link.pass_ms(350)
    assert link.delivered(link.to_slave) == []
    link.receive("session/event", "afm_node@slave", **ack, id="stop")
    link.receive("teleop/forward", "controller@master", **HALF)
    link.pass_ms(350)
    assert len(link.delivered(link.to_slave)) == 1

"""The datagrams that a relay carries: who gets a place, what is carried, and how two ends find a way past it."""

import pytest
from relay_bench import MASTER, RELAY, RELAY_ADDRESS, SLAVE, STRANGER, End, Network, key_pair
from telenano_wide_area.relay.forwarder import PLACE_S
from telenano_wide_area.relay.protocol import (
    COOKIE_BYTES,
    REQUEST_BYTES,
    TO_RELAY,
    SharedKeys,
    make_request,
    parse_request,
    raw_key,
    request_bytes,
)
from telenano_wide_area.sealed import MOST_BYTES, RejectedError

from telenano.runtime import KeyPair

ELSEWHERE = ("192.0.2.66", 666)


def blocked(end: End, to: object) -> bool:
    return False


def request_of(own: KeyPair, cookie: bytes = bytes(COOKIE_BYTES), tag: bytes = b"tag!") -> bytes:
    """Return a request for a place beside the master."""
    keys = SharedKeys(own, raw_key(RELAY.public), TO_RELAY)
    return request_bytes(make_request(keys, tag, cookie, raw_key(own.public), raw_key(MASTER.public)))


def test_two_ends_that_no_router_lets_through_are_joined_by_the_relay() -> None:
    network = Network()
    network.lets_pass = blocked
    network.turns(5)
    assert [end.path.peer for end in network.ends] == [RELAY_ADDRESS, RELAY_ADDRESS]
    network.turns(200)
    assert [end.path.is_direct for end in network.ends] == [False, False]
    assert min(len(end.samples) for end in network.ends) >= 200
    # only what the other end sent, as it was sent
    assert set(network.master.samples) == {b"\0\0\0\0 sample of " + str(network.slave.address).encode()}
    assert [end.refused for end in network.ends] == [[], []]


def test_ends_that_hear_one_another_leave_the_relay_and_come_back_to_it() -> None:
    network = Network()
    network.turns(10)
    assert [end.path.peer for end in network.ends] == [network.slave.address, network.master.address]
    carried = network.forwarder.carried
    network.turns(40)
    assert network.forwarder.carried == carried
    # the routers forget: nothing comes directly any more
    network.lets_pass = blocked
    silent_ns = network.now_ns
    while network.master.path.is_direct or network.slave.path.is_direct:
        network.turn()
        assert network.now_ns - silent_ns < 500_000_000
    before = [len(end.samples) for end in network.ends]
    network.turns(10)
    assert [len(end.samples) - count for end, count in zip(network.ends, before, strict=True)] == [10, 10]
    # and let through again: it takes one of the rarer tries
    network.lets_pass = lambda end, to: True
    network.turns(101)
    assert [end.path.is_direct for end in network.ends] == [True, True]


def test_a_way_that_leads_in_one_direction_only_is_not_taken() -> None:
    network = Network()
    network.lets_pass = lambda end, to: end is network.master
    network.turns(50)
    assert [end.path.is_direct for end in network.ends] == [False, False]
    assert min(len(end.samples) for end in network.ends) >= 45


def test_without_a_direct_way_neither_end_learns_the_address_of_the_other() -> None:
    network = Network(direct=False)
    network.turns(50)
    assert sum(len(datagram) == REQUEST_BYTES for datagram, _ in network.sent) < 20
    assert {to for _, to in network.sent} == {RELAY_ADDRESS}
    assert min(len(end.samples) for end in network.ends) >= 45
    mixed = Network()
    mixed.slave = End(mixed, SLAVE, MASTER, mixed.slave.address, direct=False)
    mixed.ends = (mixed.master, mixed.slave)
    mixed.turns(50)
    assert {to for _, to in mixed.sent} == {RELAY_ADDRESS}
    assert min(len(end.samples) for end in mixed.ends) >= 45


def test_a_relay_that_forgot_everything_gives_places_again() -> None:
    network = Network()
    network.lets_pass = blocked
    network.turns(10)
    network.relay_runs = False
    network.turns(20)
    network.start_relay()
    network.relay_runs = True
    before = [len(end.samples) for end in network.ends]
    network.turns(20)
    assert min(len(end.samples) - count for end, count in zip(network.ends, before, strict=True)) >= 10


def test_an_end_whose_router_gives_it_another_port_takes_its_place_along() -> None:
    network = Network()
    network.lets_pass = blocked
    network.turns(10)
    network.slave.address = ("203.0.113.1", 2002)
    network.turns(20)
    before = len(network.slave.samples)
    network.turns(10)
    assert len(network.slave.samples) - before == 10
    assert len(network.forwarder.places) == 2


def test_a_request_from_a_forged_address_gets_less_than_it_sent_and_no_place() -> None:
    forwarder = Network().forwarder
    request = request_of(SLAVE)
    assert len(request) == REQUEST_BYTES
    ((answer, to),) = forwarder.outgoing(request, ELSEWHERE)
    assert to == ELSEWHERE
    assert len(answer) * 10 < len(request)
    assert forwarder.places == {}
    # the cookie of one address is none at another
    cookie = answer[5:]
    ((again, _),) = forwarder.outgoing(request_of(SLAVE, cookie), ("192.0.2.67", 666))
    assert len(again) == len(answer)
    assert forwarder.places == {}
    ((joined, _),) = forwarder.outgoing(request_of(SLAVE, cookie), ELSEWHERE)
    assert len(answer) < len(joined) < len(request)
    assert len(forwarder.places) == 1


def test_a_request_that_was_heard_is_of_no_use_from_elsewhere() -> None:
    network = Network()
    network.lets_pass = blocked
    network.turns(10)
    heard = [datagram for datagram, _ in network.sent if len(datagram) == REQUEST_BYTES]
    for datagram in heard:
        for answer, _ in network.forwarder.outgoing(datagram, ELSEWHERE):
            assert len(answer) == 5 + COOKIE_BYTES
    assert {place.address for place in network.forwarder.places.values()} == {end.address for end in network.ends}


def test_who_is_not_listed_gets_nothing_and_is_counted() -> None:
    network = Network()
    ((answer, _),) = network.forwarder.outgoing(request_of(STRANGER), ELSEWHERE)
    assert network.forwarder.outgoing(request_of(STRANGER, answer[5:]), ELSEWHERE) == []
    assert network.forwarder.refused["unlisted"] == 1
    # somebody else's key without its secret
    forged = bytearray(request_of(STRANGER, answer[5:]))
    forged[8 + 4 + COOKIE_BYTES :][:32] = raw_key(SLAVE.public)
    forged[28:60] = raw_key(SLAVE.public)
    assert network.forwarder.outgoing(bytes(forged), ELSEWHERE) == []
    assert network.forwarder.refused["forged"] == 1
    assert network.forwarder.places == {}


@pytest.mark.parametrize(
    ("datagram", "cause"),
    [(b"tnrelay1" + bytes(100), "malformed"), (b"anything", "unknown_address"), (b"", "unknown_address")],
)
def test_what_is_no_request_of_a_known_end_is_dropped(datagram: bytes, cause: str) -> None:
    forwarder = Network().forwarder
    assert forwarder.outgoing(datagram, ELSEWHERE) == []
    assert forwarder.refused == {cause: 1}
    with pytest.raises(RejectedError):
        parse_request(datagram)


def test_an_end_alone_is_heard_by_nobody_and_places_end() -> None:
    network = Network()
    network.ends = (network.master,)
    network.turns(10)
    assert network.forwarder.carried == 0
    assert network.forwarder.refused["alone"] > 5
    network.now_ns += round((PLACE_S + 1.0) * 1e9)
    network.forwarder.tidy()
    assert network.forwarder.places == {}


def test_a_revoked_key_loses_its_place_at_the_next_look() -> None:
    network = Network()
    network.lets_pass = blocked
    network.turns(10)
    network.allowed.discard(raw_key(SLAVE.public))
    network.forwarder.tidy()
    network.turns(10)
    before = len(network.master.samples)
    network.turns(10)
    assert len(network.master.samples) == before
    assert network.forwarder.refused["unlisted"] > 0


def test_a_machine_has_a_bounded_number_of_places_and_bytes() -> None:
    network = Network(mbit_per_s=0.1)
    forwarder = network.forwarder
    keys = SharedKeys(SLAVE, raw_key(RELAY.public), TO_RELAY)
    for number in range(5, 60):
        address = ("192.0.2.9", number)
        peer = raw_key(key_pair(number).public)
        cookie = bytes(COOKIE_BYTES)
        for _ in range(2):
            made = make_request(keys, b"tag!", cookie, raw_key(SLAVE.public), peer)
            for answer, _ in forwarder.outgoing(request_bytes(made), address):
                cookie = answer[5 : 5 + COOKIE_BYTES]
    assert len(forwarder.places) == 16
    assert forwarder.refused["places"] == 39
    network = Network(mbit_per_s=0.1)
    network.lets_pass = blocked
    network.turns(10)
    carried = [bool(network.forwarder.outgoing(bytes(1000), network.master.address)) for _ in range(30)]
    assert 5 <= sum(carried) <= 12
    assert network.forwarder.outgoing(bytes(MOST_BYTES + 1), network.master.address) == []


def test_what_nobody_with_the_key_says_moves_no_end() -> None:
    network = Network()
    network.lets_pass = blocked
    network.turns(10)
    master = network.master
    pings = [datagram for datagram, to in network.sent if to == master.address]
    for kind in (0, 1, 2, 3, 9):
        master.take(master.path.tag + bytes([kind]) + bytes(60), ELSEWHERE)
        master.take(master.path.tag + bytes([kind]) + bytes(60), RELAY_ADDRESS)
    assert master.path.peer == RELAY_ADDRESS
    assert set(master.refused) == {"unknown_key", "forged", "malformed"}
    # a genuine ping from elsewhere is answered there, and answers of before are none
    assert pings
    before = len(network.sent)
    master.take(pings[-1], ELSEWHERE)
    assert [to for _, to in network.sent[before:]] == [ELSEWHERE]
    assert master.path.peer == RELAY_ADDRESS


def test_an_answer_to_a_ping_of_long_ago_does_not_choose_the_way() -> None:
    network = Network()
    network.turns(10)
    answers = [datagram for datagram, to in network.sent if to == network.master.address and datagram[4:5] == b"\3"]
    assert answers
    network.lets_pass = blocked
    network.turns(60)
    assert not network.master.path.is_direct
    network.master.take(answers[0], ELSEWHERE)
    assert not network.master.path.is_direct
    assert network.master.refused[-1] == "replayed"

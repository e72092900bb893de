"""The link's datagrams: keys, attacks, both ways, fall back, addresses, ground truth."""

import random
import socket
from collections.abc import Iterator

import pytest
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from hypothesis import given
from hypothesis import strategies as st
from telenano_wide_area.datagram.agreement import REKEY_NS, Agreement
from telenano_wide_area.datagram.arrivals import ArrivalRecord, LinkNetwork
from telenano_wide_area.datagram.body import MOST_SAMPLE_BYTES, REPORT, SHORT_REPORT, packed, parse, short_report
from telenano_wide_area.datagram.command_reach import ConnectionWatch
from telenano_wide_area.datagram.pacing import MOST_REPEATS, NETWORK_BYTES, Repeats, SendBudget, repeats_for
from telenano_wide_area.datagram.reception import FIRST_NS
from telenano_wide_area.datagram.replay_window import WINDOW, ReplayWindow
from telenano_wide_area.datagram.sealing import (
    HEADER,
    OVERHEAD_BYTES,
    DirectionKeys,
    KeyPair,
    Opener,
    Sealer,
)
from telenano_wide_area.doubles.datagram_bench import SOURCES, STEP_NS, Pair, Side, pair
from telenano_wide_area.link_end import place_of
from telenano_wide_area.sealed import MOST_BYTES, RejectedError

from telenano.testing import payload

KEYS = DirectionKeys(bytes(range(32)), b"abcd")


@pytest.fixture
def ends() -> Iterator[Pair]:
    with pair() as made:
        yield made


# --- the replay window ---


@given(st.lists(st.integers(0, 3 * WINDOW), max_size=300))
def test_the_window_accepts_each_number_once_and_none_that_is_too_old(numbers: list[int]) -> None:
    window, seen = ReplayWindow(), set[int]()
    for number in numbers:
        newest = max(seen, default=-1)
        expected = number not in seen and newest - number < WINDOW
        assert window.is_new(number) is expected
        if expected:
            window.record(number)
            seen.add(number)
        assert window.newest == max(seen)


def test_the_window_forgets_nothing_when_it_moves_by_less_than_a_word() -> None:
    window = ReplayWindow()
    for number in range(0, 5 * WINDOW, 7):
        window.record(number)
    newest = window.newest
    for number in range(newest - WINDOW + 1, newest + 1):
        assert window.has(number) is (number % 7 == 0)


# --- sealing ---


def test_a_datagram_is_the_standard_cipher_with_the_number_as_nonce() -> None:
    sealer = Sealer(KEYS)
    sealer.seal(b"first")
    second = sealer.seal(b"second")
    header = second[: HEADER.size]
    assert HEADER.unpack(header) == (b"abcd", 1)
    plain = ChaCha20Poly1305(KEYS.key).decrypt(bytes(4) + (1).to_bytes(8, "big"), second[HEADER.size :], header)
    assert plain == b"second"
    assert len(second) == len(b"second") + OVERHEAD_BYTES


def test_both_ends_agree_and_each_direction_has_a_key_of_its_own() -> None:
    master, slave, stranger = KeyPair(), KeyPair(), KeyPair()
    forward, backward = master.agree(slave.public, is_master=True)
    assert slave.agree(master.public, is_master=False) == (backward, forward)
    assert forward.key != backward.key
    assert forward.tag != backward.tag
    assert stranger.agree(master.public, is_master=False)[1].key != forward.key
    with pytest.raises(ValueError, match="shared key"):
        master.agree(bytes(32), is_master=True)


def test_what_was_changed_anywhere_is_forged_and_does_not_move_the_window() -> None:
    sealed = Sealer(KEYS).seal(b"a sample")
    for place in range(4, len(sealed)):
        opener = Opener(KEYS, 0)
        changed = bytearray(sealed)
        changed[place] ^= 1
        cause = "replayed" if int.from_bytes(changed[4:12], "big") >= 2**63 else "forged"
        with pytest.raises(RejectedError, match=cause):
            opener.open(bytes(changed), 0)
        assert opener.window.newest == -1
        assert opener.open(sealed, 0) == (0, b"a sample")
        with pytest.raises(RejectedError, match="replayed"):
            opener.open(sealed, 0)


# --- keys ---


def agreed(master: Agreement, slave: Agreement, now_ns: int) -> None:
    """Let both hear one another as often as they need."""
    for _ in range(3):
        slave.hear(master.public, b"", now_ns)
        master.hear(slave.public, slave.peer_public, now_ns)


def crosses(one: Agreement, other: Agreement) -> bool:
    assert one.sealer is not None
    datagram = one.sealer.seal(b"x")
    opener = other.openers.get(datagram[:4])
    if opener is None:
        return False
    opener.open(datagram, 0)
    other.opened(opener)
    return True


def test_keys_are_changed_without_a_datagram_that_cannot_be_opened() -> None:
    master, slave = Agreement(0, is_master=True), Agreement(0, is_master=False)
    agreed(master, slave, 0)
    tags = set(master.tags)
    for hour in range(1, 4):
        now = hour * REKEY_NS
        assert master.maintain(now, silent=False)
        # at each moment of the exchange both still understand one another
        assert crosses(master, slave)
        assert crosses(slave, master)
        slave.hear(master.public, b"", now)
        assert crosses(slave, master)
        assert crosses(master, slave)
        master.hear(slave.public, slave.peer_public, now)
        assert crosses(slave, master)
        assert crosses(master, slave)
        assert crosses(slave, master)
        assert slave.sealer is not None
        assert slave.sealer.number == 1
        for agreement in (master, slave):
            agreement.maintain(now + REKEY_NS // 2, silent=False)
            assert len(agreement.tags) == 1
        assert not tags & set(master.tags)
        tags |= set(master.tags)


def test_no_pair_of_public_keys_is_used_twice_for_its_numbers_would_begin_again() -> None:
    master = Agreement(0, is_master=True)
    slaves = [KeyPair() for _ in range(2)]
    seen = set()
    for public in (slaves[0].public, slaves[1].public, slaves[0].public, slaves[1].public):
        for _ in range(2):
            if master.hear(public, master.public, 0):
                assert master.sealer is not None
                key = (master.public, public)
                assert key not in seen
                seen.add(key)
    assert len(seen) >= 3
    before = master.public
    master.forget(0)
    assert master.public != before
    assert master.tags == []


def test_an_answer_to_another_offer_is_not_taken() -> None:
    master = Agreement(0, is_master=True)
    assert not master.hear(KeyPair().public, KeyPair().public, 0)
    assert not master.hear(KeyPair().public, b"", 0)
    assert master.sealer is None


# --- what is in a datagram, and how much ---


@given(st.binary(max_size=200))
def test_a_body_of_any_bytes_is_parsed_or_refused(body: bytes) -> None:
    try:
        found = parse(body)
    except RejectedError as error:
        assert error.cause in ("malformed", "time", "count")
    else:
        head = short_report(found.report.sent_ns) if body[0] >= 0x80 else REPORT.pack(*found.report)
        samples = b"".join(packed(topic.decode(), payload) for topic, payload in found.samples)
        assert body.startswith(head)
        assert parse(head + samples).samples == found.samples


def test_repeats_follow_the_loss_and_fit() -> None:
    assert [repeats_for(share) for share in (0.0, 0.001, 0.01, 0.02, 0.05, 0.09, 0.5)] == [0, 0, 1, 1, 2, 2, 4]
    repeats = Repeats(None)
    repeats.adapt(1000, 1000)
    assert repeats.count == 0
    repeats.adapt(2000, 1900)
    assert repeats.loss_share == pytest.approx(0.05, rel=0.01)
    assert repeats.count == 2
    samples = [packed("teleop/forward", random.Random(number).randbytes(290)) for number in range(6)]
    joined = [repeats.with_repeats(sample, 1e9) for sample in samples]
    assert joined[5] == samples[5] + samples[4] + samples[3]
    most = Repeats(MOST_REPEATS)
    for sample in samples:
        filled = most.with_repeats(sample, 1e9)
        assert len(filled) <= MOST_SAMPLE_BYTES
    assert filled == b"".join(samples[:2:-1])
    # a budget that is nearly used up has room for the newest alone
    assert most.with_repeats(samples[0], len(samples[0]) + OVERHEAD_BYTES) == samples[0]


def test_the_budget_bounds_what_is_sent_over_any_time() -> None:
    budget, sent = SendBudget(1000.0, 0), 0
    for tick in range(1, 10_001):
        if budget.left_bytes(tick * 1_000_000) >= 300:
            budget.spend(300)
            sent += 300 + NETWORK_BYTES
    assert sent * 8e-3 / 10.0 == pytest.approx(1000.0, rel=0.01)


# --- ground truth ---


def test_each_datagram_is_counted_arrived_late_or_lost() -> None:
    draw = random.Random(7)
    window, account = ReplayWindow(), ArrivalRecord()
    account.begin(window)
    fates = {number: draw.choice(("arrives", "arrives", "arrives", "lost", "late")) for number in range(1000)}
    fates[999] = "arrives"
    held: list[int] = []
    for number, fate in fates.items():
        now = number * 1_000_000
        due = [number] if fate == "arrives" else []
        if fate == "late":
            held.append(number)
        elif held and fate == "arrives":
            due += held
            held = []
        for arrived in due:
            window.record(arrived)
            account.record(arrived, arrived * 1_000_000, now + 5_000_000)
        account.settle(now)
    account.settle(999_000_000 + LinkNetwork.SETTLE_NS)
    lost = {number for number, fate in fates.items() if fate == "lost"}
    assert account.sent == 1000
    assert account.lost == len(lost)
    assert account.late == sum(fate == "late" for fate in fates.values())
    assert account.arrived + account.lost == account.sent
    rows = list(zip(*account.take_fates(), strict=True))
    assert {number for number, _, _, was_lost in rows if was_lost} == lost
    assert sorted(number for number, *_ in rows) == list(range(1000))
    assert min(raw_ns for _, _, raw_ns, was_lost in rows if not was_lost) == 5_000_000
    # one that comes after it was given up is late, and no longer lost
    straggler = min(lost)
    window.record(straggler)
    account.record(straggler, 0, 10**10)
    assert account.lost == len(lost) - 1
    assert account.arrived + account.lost == account.sent


# --- both ends ---


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_samples_cross_both_ways_and_tcp_is_no_longer_asked_for(host: str) -> None:
    with pair(host) as ends:
        ends.joined()
        assert ends.master.log.topics == {"link/key", "sparse/teleop/backward", "sparse/law/status"}
        assert ends.slave.log.topics == {"link/key", "sparse/teleop/forward"}
        for side, other in ((ends.master, ends.slave), (ends.slave, ends.master)):
            assert side.seqs == list(range(side.seqs[0], other.seq))
            # signs of life from before the keys were agreed
            assert side.end.rejected in ({}, {"unknown_key": 1})
            assert side.seqs[0] < 20
            assert [event.level for event in side.events] == ["info"]


def test_delays_are_measured_across_clocks_that_differ() -> None:
    with pair(ahead_ns=3_600 * 10**9) as ends:
        ends.joined()
        found = ends.master.outlet.last("link/network")
        assert found.clock.valid
        assert found.clock.offset_s == pytest.approx(3600.0, abs=1e-9)
        assert found.delay_valid
        # both turn at the same moments: a sample takes no time, a sign of life is taken in the next turn
        assert (found.delay_min_s, found.delay_max_s) == (0.0, pytest.approx(STEP_NS * 1e-9, rel=1e-6))
        assert (found.lost, found.late) == (0, 0)
        assert found.sent == found.arrived
        assert found.number.to_numpy().tolist() == sorted(found.number.to_numpy().tolist())


def test_a_report_waits_for_a_turn_in_which_nothing_has_arrived(ends: Pair) -> None:
    ends.joined()
    slave = ends.slave
    slave.end._maintain_ns = slave.end._report_ns = slave.clock.monotonic_ns()
    ends.master.send()
    published, seen = len(slave.outlet.sent), len(slave.received)
    slave.take()
    assert len(slave.received) == seen + 1
    assert len(slave.outlet.sent) == published
    slave.take()
    assert [topic for topic, _ in slave.outlet.sent[published:]] == ["link/network"]
    # where every turn brings something it does not wait for ever
    for _ in range(3):
        slave.end._report_ns = 0
        published = len(slave.outlet.sent)
        for _ in range(8):
            slave.clock.advance_ns(STEP_NS)
            ends.master.send()
            slave.take()
        assert len(slave.outlet.sent) > published


class Attacker:
    """Someone on the network: sees every datagram to the slave's end, and sends what he likes."""

    def __init__(self, victim: Side) -> None:
        self.victim = victim
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)

    def seize(self) -> bytes:
        """Take the next datagram off the wire, before its reader."""
        return bytes(self.victim.end.socket.recv(2048))

    def send(self, datagram: bytes) -> None:
        self.socket.sendto(datagram, ("127.0.0.1", self.victim.port))

    def answers(self) -> bytes:
        try:
            return bytes(self.socket.recv(2048))
        except BlockingIOError:
            return b""


@pytest.fixture
def attacker(ends: Pair) -> Iterator[Attacker]:
    made = Attacker(ends.joined().slave)
    yield made
    made.socket.close()


def test_attacks_reach_no_node_are_counted_and_are_not_answered(ends: Pair, attacker: Attacker) -> None:
    slave = ends.slave
    before = len(slave.received)
    ends.master.send()
    genuine = attacker.seize()
    peer = slave.end._peer
    forged = bytearray(genuine)
    forged[-1] ^= 1
    attacks = {
        "forged": bytes(forged),
        "truncated": genuine[: OVERHEAD_BYTES + SHORT_REPORT.size - 1],
        "oversized": genuine + bytes(MOST_BYTES),
        "unknown_key": b"nobody" + genuine[6:],
    }
    for cause, datagram in attacks.items():
        attacker.send(datagram)
        slave.take()
        slave.clock.advance_ns(10**9)
        slave.end.maintain(slave.clock.monotonic_ns())
        assert slave.end.rejected.get(cause) == 1, cause
    assert len(slave.received) == before
    assert slave.end._peer == peer
    # the genuine one is still taken, and once only
    attacker.send(genuine)
    slave.take()
    assert len(slave.received) == before + 1
    for _ in range(3):
        attacker.send(genuine)
    slave.take()
    assert slave.end.rejected["replayed"] == 3
    assert len(slave.received) == before + 1
    assert set(slave.end.rejected) == {*attacks, "replayed"}
    # nothing but what the end sends its peer anyway: never to whom has no key
    assert attacker.answers() == b""


def test_reordered_datagrams_bring_nothing_old_to_a_node(ends: Pair, attacker: Attacker) -> None:
    held = []
    for _ in range(5):
        ends.master.send()
        held.append(attacker.seize())
    for datagram in reversed(held):
        attacker.send(datagram)
    newest = ends.master.seq - 1
    ends.slave.take()
    assert ends.slave.seqs[-1] == newest
    assert ends.slave.seqs[-2] < newest - 4
    assert ends.slave.end.rejected == {}
    assert ends.slave.end.arrivals.late >= 4


def test_a_flood_of_what_no_key_fits_is_counted_and_ends_no_datagrams(ends: Pair, attacker: Attacker) -> None:
    for _ in range(200):
        attacker.send(b"flood" * 50)
    ends.turns(60)
    assert ends.slave.seqs[-1] == ends.master.seq - 1
    assert ends.slave.end.rejected == {"unknown_key": 200}
    assert ends.slave.end.arrivals.lost == 0
    assert ends.slave.end.receiving == "datagram"


def test_a_flood_of_forgeries_with_the_right_tag_holds_no_turn(ends: Pair, attacker: Attacker) -> None:
    ends.master.send()
    genuine = attacker.seize()
    for number in range(500):
        attacker.send(genuine[:4] + (10**6 + number).to_bytes(8, "big") + genuine[12:])
    ends.slave.take()
    assert 0 < ends.slave.end.rejected["forged"] <= 64
    for _ in range(8):
        ends.slave.take()
        assert not ends.slave.end.drained or ends.slave.end.rejected["forged"] == 500
    ends.turns(2)
    assert ends.slave.end.rejected["forged"] == 500
    assert ends.slave.seqs[-1] == ends.master.seq - 1


# --- when the network changes ---


def test_blocked_datagrams_fall_back_to_tcp_and_are_taken_up_again(ends: Pair) -> None:
    ends.joined()
    sockets = [side.end.socket for side in ends.sides]
    sent = ends.master.end.outgoing.bytes
    # nothing arrives any more
    for side in ends.sides:
        side.end.socket = _Blocked(side.end.socket)  # type: ignore[assignment]
    ends.turns(200)
    assert [side.end.receiving for side in ends.sides] == ["stream", "stream"]
    assert {"teleop/backward", "law/status"} <= ends.master.log.topics
    assert "teleop/forward" in ends.slave.log.topics
    for side in ends.sides:
        warnings = [event.text for event in side.events if event.level == "warning"]
        assert ["no datagram has come" in text for text in warnings] == [True, False]
        assert all("continues over TCP, and tries again" in text for text in warnings)
        assert f"is blocked from the {side.end.machine} to the" in warnings[1]
        assert not side.end.acknowledged
    # only now and then, to find out
    spent = ends.master.end.outgoing.bytes
    ends.turns(100)
    assert 0 < ends.master.end.outgoing.bytes - spent < (spent - sent) / 2
    for side, real in zip(ends.sides, sockets, strict=True):
        side.end.socket = real
    ends.turns(150)
    assert [side.end.receiving for side in ends.sides] == ["datagram", "datagram"]
    assert ends.slave.log.whole == {"link/key"}
    assert ends.slave.seqs[-1] == ends.master.seq - 1


class _Blocked:
    """A socket whose datagrams a firewall drops."""

    def __init__(self, real: socket.socket) -> None:
        self._real = real

    def sendto(self, datagram: bytes, address: object) -> int:
        return len(datagram)

    def __getattr__(self, name: str) -> object:
        return getattr(self._real, name)


def test_the_loop_is_asked_for_over_tcp_only_after_datagrams_had_their_chance(ends: Pair) -> None:
    # the keys come over TCP as well, and a thousand samples a second would hold them up on a network that loses packets
    ends.keys_cross = False
    ends.turns(400)
    # nothing was heard of the other site, which may be started in an hour
    assert [side.log.topics for side in ends.sides] == [{"link/key"}, {"link/key"}]
    # a site that is there, and offers no key
    for side in ends.sides:
        frames = [side.incoming.encode(), payload(side.incoming, SOURCES[side.incoming], 0)]
        side.subscriber.take([(frames, side.clock.now_ns())])
    turns = FIRST_NS // STEP_NS
    ends.turns(turns - 10)
    assert [side.log.topics for side in ends.sides] == [{"link/key"}, {"link/key"}]
    ends.turns(20)
    assert {"teleop/backward", "law/status"} <= ends.master.log.topics
    assert "teleop/forward" in ends.slave.log.topics


def test_datagrams_that_are_blocked_from_the_beginning_leave_tcp(ends: Pair) -> None:
    for side in ends.sides:
        side.end.socket = _Blocked(side.end.socket)  # type: ignore[assignment]
    ends.turns(FIRST_NS // STEP_NS - 10)
    assert "teleop/forward" not in ends.slave.log.topics
    ends.turns(40)
    assert "teleop/forward" in ends.slave.log.topics
    assert {"teleop/backward", "law/status"} <= ends.master.log.topics
    assert [side.end.receiving for side in ends.sides] == ["stream", "stream"]


def test_an_end_that_may_not_fall_back_says_so(ends: Pair) -> None:
    with pair(transport="datagram") as strict:
        assert strict.slave.log.topics == {"link/key"}
        strict.keys_cross = False
        strict.turns(550)
        assert strict.slave.log.topics == {"link/key"}
        assert "allows no TCP" in strict.slave.events[-1].text


def test_a_sender_whose_address_changes_is_followed_and_a_forger_is_not(ends: Pair) -> None:
    ends.joined()
    old = ends.slave.end.socket
    new = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    new.setblocking(False)
    ends.slave.end.socket, ends.slave.end.descriptor = new, new.fileno()
    old.close()
    seq = ends.slave.seq
    ends.turns(20)
    assert ends.master.seqs[-1] >= seq + 15
    assert ends.slave.seqs[-1] == ends.master.seq - 1
    assert ends.master.end._peer is not None
    assert ends.master.end._peer[1] == new.getsockname()[1]
    assert any("now come from" in event.text for event in ends.master.events)


def test_keys_that_change_in_mid_session_lose_nothing(ends: Pair) -> None:
    ends.joined()
    first = ends.slave.end._agreement.public
    for side in ends.sides:
        side.end._agreement._made_ns -= REKEY_NS
    ends.turns(100)
    assert ends.slave.end._agreement.public != first
    for side, other in ((ends.master, ends.slave), (ends.slave, ends.master)):
        assert side.seqs == list(range(side.seqs[0], other.seq))
        assert side.end.arrivals.lost == 0
        assert side.end.arrivals.arrived == side.end.arrivals.sent
        assert side.end.rejected in ({}, {"unknown_key": 1})
        assert side.end.receiving == "datagram"


def test_a_key_that_is_in_use_is_hardly_ever_offered_and_at_once_where_it_is_lacking(ends: Pair) -> None:
    ends.joined()

    def offered(turns: int) -> list[int]:
        before = [len(side.outlet.sent) for side in ends.sides]
        ends.turns(turns)
        sent = [side.outlet.sent[first:] for side, first in zip(ends.sides, before, strict=True)]
        return [sum(topic == "link/key" for topic, _ in messages) for messages in sent]

    assert max(offered(1000)) <= 2
    # the other end was started anew, or keys are lost: nothing comes under those that are in use
    for side in ends.sides:
        side.end.socket = _Blocked(side.end.socket)  # type: ignore[assignment]
    assert min(offered(200)) >= 3


def test_a_revoked_machine_can_neither_send_nor_is_it_sent_anything(ends: Pair) -> None:
    ends.joined()
    ends.master.is_allowed = False
    ends.master.end.apply_permissions()
    received, sent = len(ends.master.received), ends.master.end.outgoing.bytes
    ends.turns(100)
    assert len(ends.master.received) == received
    assert ends.master.end.outgoing.bytes == sent
    assert ends.master.end.receiving == "stream"
    ends.master.is_allowed = True
    ends.turns(150)
    assert ends.master.end.receiving == "datagram"


def test_an_end_that_is_started_again_is_taken_up(ends: Pair) -> None:
    import zmq

    ends.joined()
    port = ends.master.port
    ends.master.end.close()
    ends.master.real_socket.close()
    context = zmq.Context.instance()
    ends.master = Side(context, is_master=True, master_port=port, host="127.0.0.1", ahead_ns=0)
    ends.master.clock.advance_ns(ends.slave.clock.monotonic_ns() - ends.master.clock.monotonic_ns())
    ends.turns(300)
    assert [side.end.receiving for side in ends.sides] == ["datagram", "datagram"]
    assert ends.slave.seqs[-1] == ends.master.seq - 1


def test_repetitions_give_way_before_a_sample_is_left_out() -> None:
    # room for three deflated samples a turn, and a setting that asks for five
    with pair(repeats=4, budget_kbit_per_s=330.0) as ends:
        ends.turns(400)
        sent = ends.master.end.outgoing.bytes
        ends.turns(400)
        assert ends.master.end.outgoing.unsent == 0
        assert ends.slave.seqs[-1] == ends.master.seq - 1
        rate_kbit_per_s = (ends.master.end.outgoing.bytes - sent) * 8e-3 / 4.0
        assert 0.8 * 330.0 < rate_kbit_per_s <= 330.0 + 1.0


class RelayAlone:
    """Stands for the way through a relay: it has no place to give, and takes nothing."""

    tag, peer, is_direct = b"none", None, False

    def maintain(self, now_ns: int, silence_ns: int) -> None:
        """Do nothing."""


@pytest.mark.parametrize("relayed", [False, True])
def test_no_sample_counts_while_no_command_could_cross(ends: Pair, relayed: bool) -> None:
    if relayed:
        for side in ends.sides:
            side.end._relay = RelayAlone()  # type: ignore[assignment]
        ends.master.end._peer = ("127.0.0.1", ends.slave.port)
    ends.joined()
    before = len(ends.slave.seqs)
    ends.turns(10)
    assert len(ends.slave.seqs) - before == 10
    for side in ends.sides:
        side.is_connected = False
    ends.turns(120)
    before = [len(side.seqs) for side in ends.sides]
    ends.turns(50)
    assert [len(side.seqs) for side in ends.sides] == before
    # signs of life go on, so that nothing has to be found again
    assert [side.end.receiving for side in ends.sides] == ["datagram", "datagram"]
    for side in ends.sides:
        side.is_connected = True
    # Turns of 10 ms look like a queue to signs of life alone, so that fewer samples are sent at first.
    ends.turns(60)
    assert min(len(side.seqs) - count for side, count in zip(ends.sides, before, strict=True)) >= 10
    texts = [event.text for side in ends.sides for event in side.events]
    assert sum("no command can cross" in text for text in texts) == 2
    assert sum("the link's datagrams continue" in text for text in texts) == 2


@pytest.mark.parametrize("lost", ["master", "slave"])
def test_one_end_that_no_command_could_reach_is_enough(ends: Pair, lost: str) -> None:
    ends.joined()
    getattr(ends, lost).is_connected = False
    ends.turns(120)
    before = [len(side.seqs) for side in ends.sides]
    ends.turns(50)
    # It neither sends nor takes, so the loop is open; the other one sends on, to nobody who acts on it.
    assert [len(side.seqs) for side in ends.sides] == before


@pytest.mark.parametrize(("loss_share", "kept_ms"), [(0.0, 1000), (0.009, 1000), (0.02, 4000)])
def test_where_the_network_loses_datagrams_a_connection_has_longer_to_come_back(
    loss_share: float, kept_ms: int
) -> None:
    connected = [True]
    touch = ConnectionWatch(lambda: connected[0], "slave", 0)
    touch.look(0, arriving=True, loss_share=loss_share)
    connected[0] = False
    kept = 0
    while touch.is_kept:
        kept += 50
        touch.look(kept * 1_000_000, arriving=True, loss_share=loss_share)
    assert kept == kept_ms


def test_a_connection_that_is_made_again_at_once_costs_no_sample_and_no_word(ends: Pair) -> None:
    ends.joined()
    before = len(ends.slave.seqs)
    for turn in range(300):
        for side in ends.sides:
            side.is_connected = turn % 100 >= 90
        ends.turn()
    assert len(ends.slave.seqs) - before == 300
    assert [event.text for side in ends.sides for event in side.events if "command" in event.text] == []


def test_an_end_holds_what_arrives_until_its_time() -> None:
    with pair(play_out=True) as ends:
        ends.turns(150)
        assert [side.end.receiving for side in ends.sides] == ["datagram", "datagram"]
        slave = ends.slave
        before = len(slave.received)
        # the network takes 20 ms longer: what comes now is late, the target rises, and nothing is lost
        for _ in range(100):
            for side in ends.sides:
                side.clock.advance_ns(STEP_NS)
            ends.master.send()
            if _ % 2:
                slave.take()
        assert len(slave.received) > before
        assert slave.seqs == sorted(slave.seqs)
        assert slave.end.due_ns > slave.clock.monotonic_ns()
        held = slave.end.held
        assert held is not None
        waiting_ns = held.due_ns
        slave.clock.advance_ns(10 * STEP_NS)
        slave.take()
        assert held.due_ns > waiting_ns
        assert slave.seqs[-1] == ends.master.seq - 1


@pytest.mark.parametrize(
    ("own", "bound"),
    [
        ("tcp://192.168.7.2:5560", "192.168.7.2"),
        ("tcp://0.0.0.0:5560", "0.0.0.0"),
        ("ipc:///run/x", "0.0.0.0"),
        ("", "0.0.0.0"),
        ("tcp://[fe80::1]:5560", "0.0.0.0"),
    ],
)
def test_the_end_at_the_slave_binds_the_address_of_its_site(own: str, bound: str) -> None:
    place = place_of("tcp://192.168.7.1:5561", None, own)
    assert place.bind == (bound, 0)
    assert place.peer == ("192.168.7.1", 5561)
    assert place_of("tcp://192.168.7.1:5561", 6000, None).bind == ("192.168.7.1", 6000)

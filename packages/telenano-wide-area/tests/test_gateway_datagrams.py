"""The datagrams between a gateway and a rig: what is opened, what is refused, and which frames cross by them at all."""

import asyncio

import msgpack
import pytest
from relay_bench import MASTER, RELAY, RELAY_ADDRESS, SLAVE, STRANGER
from telenano_wide_area.gateway.datagrams import FELT, HAND, MOST_FRAME_BYTES, PROBE, PageDatagrams, is_of
from telenano_wide_area.relay.channel import Budget, Channel
from telenano_wide_area.relay.forwarder import Forwarder
from telenano_wide_area.relay.path import RelayPath
from telenano_wide_area.relay.protocol import CHALLENGE_BYTES, TO_RELAY, SharedKeys, raw_key
from telenano_wide_area.sealed import RejectedError

NUMBER, OTHER = b"12345678", b"87654321"
HAND_FRAME = msgpack.packb({"k": "hand", "force_n": 1.0, "held": True, "number": 2**53, "stamp_s": 1e6})


def ends(rig: object = MASTER) -> tuple[PageDatagrams, PageDatagrams]:
    gateway = PageDatagrams(RELAY, raw_key(MASTER.public), is_gateway=True)
    return gateway, PageDatagrams(rig, raw_key(RELAY.public), is_gateway=False)  # type: ignore[arg-type]


def test_each_end_opens_what_the_other_has_sealed_and_nothing_else() -> None:
    gateway, rig = ends()
    down = gateway.seal(NUMBER, HAND_FRAME)
    assert rig.open(down) == (NUMBER, HAND_FRAME)
    assert gateway.open(rig.seal(NUMBER, b"felt")) == (NUMBER, b"felt")
    changed = [down[:place] + bytes((down[place] ^ 1,)) + down[place + 1 :] for place in range(len(down))]
    # Nor does one go to the page of another number, come back as if the other end had sent it, or reach another rig.
    for opener, wrong in [
        *((rig, each) for each in changed),
        *((rig, down[:length]) for length in range(len(down))),
        (rig, OTHER + down[8:]),
        (gateway, down),
        (ends(STRANGER)[1], down),
    ]:
        with pytest.raises(RejectedError):
            opener.open(wrong)


def test_only_small_frames_of_hand_and_force_cross_by_datagrams() -> None:
    felt = msgpack.packb({"k": "felt", "force_n": 1.0, "age_s": 0.01, "number": 2**53, "stamp_s": 1e6})
    probe = msgpack.packb({"k": "probe", "stamp_s": 1e6})
    found = [[is_of(frame, kind) for kind in (HAND, FELT, PROBE)] for frame in (HAND_FRAME, felt, probe)]
    assert found == [[True, False, False], [False, True, False], [False, False, True]]
    for frame in (
        b"",
        msgpack.packb({"k": "estop", "id": "a"}),
        msgpack.packb({"token": "hand", "k": "hand"}),
        msgpack.packb({"k": "hand", "filled": b"0" * MOST_FRAME_BYTES}),
    ):
        assert not is_of(frame, HAND, FELT, PROBE)


def test_a_relay_gives_its_own_machine_what_an_end_sends_it_and_sends_back() -> None:
    came: list[tuple[bytes, bytes]] = []
    rig, gateway = raw_key(SLAVE.public), raw_key(RELAY.public)
    forwarder = Forwarder(RELAY, lambda _: True, lambda _: Budget(1e9, 1e9, 0.0), lambda: 0.0)
    keys = SharedKeys(SLAVE, gateway, TO_RELAY)
    path = RelayPath(RELAY_ADDRESS, keys, keys, rig, gateway, direct=False)
    address = ("198.51.100.1", 40000)

    def carry(datagram: bytes, _: object) -> None:
        for data, to in forwarder.outgoing(datagram, address):
            assert to == address
            path.take(data, RELAY_ADDRESS)

    path.send = carry
    path.maintain(10**9, 0)
    assert path.peer == RELAY_ADDRESS
    # A relay without a gateway takes nothing for itself.
    assert forwarder.take(b"sample", address) is None
    assert forwarder.refused == {"alone": 1}
    forwarder.deliver = lambda public, datagram: came.append((public, datagram))
    assert forwarder.take(b"sample", address) is None
    assert came == [(rig, b"sample")]
    # One without a place sends nothing here, and none is sent to it.
    forwarder.take(b"sample", ("203.0.113.9", 1))
    assert len(came) == 1
    assert not forwarder.send(raw_key(STRANGER.public), b"felt")


@pytest.mark.parametrize("length", [0, 1, 16_320, 16_321, 300_000])
def test_a_sealed_connection_carries_bytes_of_any_length(length: int) -> None:
    async def run() -> None:
        site, relay = (asyncio.StreamReader(limit=2**20) for _ in range(2))
        challenge = bytes(CHALLENGE_BYTES)

        class Writer:
            def write(self, data: bytes) -> None:
                relay.feed_data(data)

            async def drain(self) -> None:
                pass

        keys = SharedKeys(MASTER, raw_key(RELAY.public), TO_RELAY), SharedKeys(RELAY, raw_key(MASTER.public), TO_RELAY)
        sender = Channel(site, Writer(), keys[0], challenge, is_relay=False)  # type: ignore[arg-type]
        receiver = Channel(relay, Writer(), keys[1], challenge, is_relay=True)  # type: ignore[arg-type]
        data = bytes(index % 251 for index in range(length))
        await sender.send_bytes(data)
        assert await receiver.receive_bytes(length) == data
        await sender.send_bytes(data + b"more")
        with pytest.raises(RejectedError):
            await receiver.receive_bytes(length)

    asyncio.run(run())

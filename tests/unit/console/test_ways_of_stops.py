"""Which way an emergency stop takes to each device, what it says, and what each inlet gets of it; without sockets."""

import os
from typing import Any, NamedTuple

import msgpack
import pytest

from telenano.console import emergency_stop
from telenano.console.emergency_stop import Answer, LocalRig, Reach, _answer, _Inlet, _Sender
from telenano.runtime.bus.holders import Holder, Look
from telenano.runtime.bus.local_endpoint import Peer
from telenano.wire import decode
from telenano.wire.messages import SessionControl

HAND, TIP, LINK = "haptic_node@master", "afm_node@slave", "delay_node@master"
OURS = Peer(1, os.geteuid())
SUBSCRIBED, LEFT = b"\x01session/control", b"\x00session/control"


class Here(NamedTuple):
    """A rig as it is found: which nodes have an inlet for stops, which others only an endpoint, which a network."""

    inlets: tuple[str, ...] = ()
    older: tuple[str, ...] = ()
    networked: tuple[str, ...] = ()
    seen: Look = Look()


def reach(monkeypatch: pytest.MonkeyPatch, here: Here, site: str, target: str = "*") -> Reach:
    further = (SLAVE_HALF, MASTER_HALF, "launcher@slave", "launcher@master")
    endpoints = {node: f"ipc:///r/{node}" for node in (HAND, TIP, LINK, *further)}
    bound = {endpoints[node] for node in (*here.inlets, *here.older)}
    bound |= {f"{endpoints[node]}.estop" for node in here.inlets}
    monkeypatch.setattr(emergency_stop, "bound_by", lambda endpoint: OURS if endpoint in bound else None)
    networks = {node: {"network": "tcp://10.0.0.2:5712"} for node in here.networked}
    rig = LocalRig({node: {"local": text, **networks.get(node, {})} for node, text in endpoints.items()}, here.seen)
    return rig.reach(target, site)


SLAVE_HALF, MASTER_HALF = "controller@slave", "controller@master"


@pytest.mark.parametrize(
    ("here", "site", "way"),
    [
        # both devices take stops here, whatever site the person is at
        (Here((HAND, TIP)), "", Reach(direct=(HAND, TIP))),
        (Here((HAND, TIP)), "slave", Reach(direct=(HAND, TIP))),
        (Here((HAND, TIP, LINK)), "master", Reach(direct=(HAND, TIP))),
        # a tip that is not here is reached through the link, whether its other nodes are here or not
        (Here((HAND, LINK)), "", Reach(direct=(HAND,), by_link=(TIP,))),
        (Here((HAND, LINK)), "master", Reach(direct=(HAND,), by_link=(TIP,))),
        (Here((HAND, LINK)), "slave", Reach(direct=(HAND,), by_link=(TIP,))),
        (Here((HAND, LINK), networked=(TIP,)), "", Reach(direct=(HAND,), by_link=(TIP,))),
        (Here((HAND, LINK), older=(SLAVE_HALF,)), "", Reach(direct=(HAND,), by_link=(TIP,))),
        # Without a link, the tip does not run where other nodes of its site do.
        (Here((HAND,), older=(SLAVE_HALF,)), "", Reach(direct=(HAND,), absent=(TIP,))),
        # and may run elsewhere where none does
        (Here((HAND,)), "", Reach(direct=(HAND,), far=(TIP,))),
        (Here((HAND,)), "master", Reach(direct=(HAND,), by_console=(TIP,))),
        (Here((HAND,), networked=(TIP,)), "", Reach(direct=(HAND,), by_console=(TIP,))),
        # A tip with a network endpoint belongs here if a launcher of its site does.
        (Here((HAND,), older=(SLAVE_HALF,), networked=(TIP,)), "", Reach(direct=(HAND,), by_console=(TIP,))),
        (Here((HAND,), older=("launcher@slave",), networked=(TIP,)), "", Reach(direct=(HAND,), absent=(TIP,))),
        # one of an older version runs and has no inlet
        (Here((HAND,), older=(TIP,)), "", Reach(direct=(HAND,), by_console=(TIP,))),
        (Here((HAND, LINK), older=(TIP,)), "", Reach(direct=(HAND,), by_console=(TIP,))),
        # a hand that is not here, as at the instrument's machine, is reached through the instrument
        (Here((TIP,)), "", Reach(direct=(TIP,), by_instrument=(HAND,))),
        (Here((TIP,), older=(SLAVE_HALF, "launcher@slave")), "slave", Reach(direct=(TIP,), by_instrument=(HAND,))),
        # The hand does not run where other nodes of its site, the link among them, are here.
        (Here((TIP, LINK)), "", Reach(direct=(TIP,), absent=(HAND,))),
        (Here((TIP,), older=(MASTER_HALF,)), "slave", Reach(direct=(TIP,), absent=(HAND,))),
        (Here((TIP, LINK), networked=(HAND,)), "", Reach(direct=(TIP,), by_instrument=(HAND,))),
        # the instrument does not run either, and its other nodes do; a launcher starts it again, and then it carries
        (Here(older=("launcher@slave",)), "", Reach(absent=(TIP,), by_instrument=(HAND,))),
        (Here(older=(SLAVE_HALF,)), "slave", Reach(absent=(TIP,), far=(HAND,))),
        (Here(older=("launcher@master",)), "", Reach(absent=(HAND,), far=(TIP,))),
        # nothing runs here
        (Here(), "", Reach(absent=(HAND, TIP))),
        (Here(), "slave", Reach(absent=(TIP,), far=(HAND,))),
        (Here(), "master", Reach(by_console=(TIP,), absent=(HAND,))),
    ],
)
def test_each_device_is_reached_the_shortest_way(
    monkeypatch: pytest.MonkeyPatch, here: Here, site: str, way: Reach
) -> None:
    assert reach(monkeypatch, here, site) == way


def test_an_instrument_that_is_not_stopped_carries_no_stop_to_the_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    assert reach(monkeypatch, Here((TIP,)), "", "haptic_node") == Reach(far=(HAND,))


@pytest.mark.parametrize(
    ("target", "direct"), [("afm_node", (TIP,)), ("haptic_node@master", (HAND,)), ("*@slave", (TIP,)), ("recorder", ())]
)
def test_only_the_devices_that_a_target_means_are_reached(
    monkeypatch: pytest.MonkeyPatch, target: str, direct: tuple[str, ...]
) -> None:
    assert reach(monkeypatch, Here((HAND, TIP, LINK)), "", target) == Reach(direct)


def test_a_tip_of_the_files_for_two_machines_is_never_called_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emergency_stop, "bound_by", lambda _: None)
    assert LocalRig.packaged(two_machines=False, seen=Look()).reach("*", "").absent == (HAND, TIP)
    assert LocalRig.packaged(two_machines=True, seen=Look()).reach("*", "") == Reach(by_console=(TIP,), absent=(HAND,))


@pytest.mark.parametrize("site", ["", "master", "slave"])
def test_a_device_that_holds_its_lock_is_reached_whether_or_not_its_socket_is_at_its_path(
    monkeypatch: pytest.MonkeyPatch, site: str
) -> None:
    held = Look(tuple(Holder(7, "7", node, f"/r/{node}", takes_signal=True) for node in (HAND, TIP, LINK)))
    whole = reach(monkeypatch, Here((HAND, TIP, LINK)), site)
    assert reach(monkeypatch, Here(seen=held), site) == whole
    assert not whole.absent
    # A player, or a device of an older version, takes no stop by a signal.
    other = Look(tuple(holder._replace(takes_signal=False) for holder in held.holders))
    assert reach(monkeypatch, Here(seen=other), site).by_console
    # The lock of a rig in another folder, or in that of a container, is that of another rig.
    for other in (
        [holder._replace(path=f"/other/{holder.node}") for holder in held.holders],
        [holder._replace(folders_of=4711) for holder in held.holders],
    ):
        assert reach(monkeypatch, Here(seen=Look(tuple(other))), site) == reach(monkeypatch, Here(), site)


@pytest.mark.parametrize("site", ["", "slave"])
def test_who_cannot_see_every_process_does_not_say_that_a_device_is_absent(
    monkeypatch: pytest.MonkeyPatch, site: str
) -> None:
    blind, plain = (reach(monkeypatch, Here(seen=Look((), text)), site) for text in ("no /proc", ""))
    assert blind == plain._replace(absent=(), unknown=plain.absent)
    assert TIP in blind.unknown
    assert plain.far == blind.far


@pytest.mark.parametrize("user", [None, os.geteuid(), 0])
def test_a_socket_of_this_user_or_root_is_believed(monkeypatch: pytest.MonkeyPatch, user: int | None) -> None:
    monkeypatch.setattr(emergency_stop, "bound_by", lambda _: Peer(7, user))
    rig = LocalRig.packaged(two_machines=False, seen=Look())
    assert rig.reach("*", "").direct == (HAND, TIP)
    assert rig.strangers() == []


def test_a_socket_of_another_user_is_told_and_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    stranger = os.geteuid() + 4711
    monkeypatch.setattr(emergency_stop, "bound_by", lambda _: Peer(7, stranger))
    rig = LocalRig.packaged(two_machines=False, seen=Look())
    assert rig.reach("*", "").absent == (HAND, TIP)
    assert not rig.is_supervised()
    assert not any(rig.is_ours(node) for node in (HAND, TIP))
    text = "\n".join(rig.strangers())
    assert f"{TIP}.estop is held by process 7 of user {stranger}, and not by a rig of this user: it is ignored" in text


@pytest.mark.parametrize("by", ["", "Ada"])
def test_a_stop_says_who_gave_it_in_the_version_of_the_wire(by: str) -> None:
    stop = decode("session/control", _Sender("slave", "abc", "afm_node", (), by).message())
    assert isinstance(stop, SessionControl)
    assert (stop.command, stop.target, stop.src, stop.id) == ("estop", "afm_node", "estop@slave", "abc")
    assert (stop.v, stop.by or "", stop.parameters) == (SessionControl.version, by, {})


class Socket:
    """What a node says to an inlet, and what it gets."""

    def __init__(self) -> None:
        self.said: list[bytes] = []
        self.got: list[bytes] = []

    def poll(self, timeout: int) -> int:
        assert timeout == 0, "a node that says nothing holds no other one up"
        return len(self.said)

    def recv(self) -> bytes:
        return self.said.pop(0)

    def send_multipart(self, frames: list[bytes]) -> None:
        topic, payload = frames
        assert topic == b"session/control"
        self.got.append(payload)


def inlet(*, whole: bool = False) -> tuple[_Inlet, Any]:
    """Return an inlet without a connection, and the node at its other end."""
    made = _Inlet.__new__(_Inlet)
    made.ready, made._whole, made._taken = False, whole, 0
    socket: Any = Socket()
    made.socket = socket
    return made, socket


def test_a_device_gets_the_stops_from_when_it_is_ready_on_and_a_recorder_those_before_as_well() -> None:
    (first, hand), (late, tip), (whole, recorder) = inlet(), inlet(), inlet(whole=True)
    sender = _Sender("slave", "abc", "*", (first, late, whole))
    # nothing is sent while no device is ready, however often it is due
    sender.send(again=True)
    recorder.said.append(SUBSCRIBED)
    sender.send(again=True)
    assert (hand.got, tip.got, recorder.got, sender._messages) == ([], [], [], [])
    # a device that is ready is sent the stop at once
    hand.said += [LEFT, SUBSCRIBED, LEFT]
    sender.send(again=False)
    assert (len(hand.got), len(recorder.got)) == (1, 1)
    # and not again until that is due
    sender.send(again=False)
    assert len(hand.got) == 1
    sender.send(again=True)
    tip.said.append(SUBSCRIBED)
    sender.send(again=False)
    assert [len(node.got) for node in (hand, tip, recorder)] == [3, 1, 3]
    assert tip.got == hand.got[2:] == sender._messages[2:]
    assert recorder.got == hand.got == sender._messages
    assert [decode("session/control", payload).seq for payload in hand.got] == [0, 1, 2]


def test_a_recorder_that_comes_late_gets_every_stop_so_far_and_makes_no_new_one() -> None:
    (ready, tip), (whole, recorder) = inlet(), inlet(whole=True)
    sender = _Sender("slave", "abc", "*", (ready, whole))
    tip.said.append(SUBSCRIBED)
    sender.send(again=False)
    sender.send(again=True)
    recorder.said.append(SUBSCRIBED)
    sender.send(again=False)
    assert recorder.got == tip.got == sender._messages
    assert len(tip.got) == 2


def test_who_subscribes_to_something_else_is_not_ready() -> None:
    made, node = inlet()
    for said in (LEFT, b"\x01session/event", b"\x01", b""):
        node.said.append(said)
        assert not made.read_subscription(0)
        assert not made.ready
    node.said.append(SUBSCRIBED)
    assert made.read_subscription(0)
    # once, and it stays ready
    node.said += [SUBSCRIBED, LEFT]
    assert not made.read_subscription(0)
    assert made.ready


def test_an_answer_has_the_identifier_of_the_stop() -> None:
    fields = {"src": TIP, "kind": "ack", "text": "stopped", "id": "a"}
    assert _answer([b"session/event", msgpack.packb(fields)], "a") == Answer(TIP, "ack", "stopped")
    assert _answer([b"session/event", msgpack.packb({**fields, "kind": "refused"})], "a") == Answer(
        TIP, "refused", "stopped"
    )
    assert _answer([b"session/event", msgpack.packb(fields)], "b") is None

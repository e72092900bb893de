"""Taking part in the bus: what is opened is closed, and a stop signal is never lost."""

import os
import select
import signal
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
import zmq

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import NullPublisher
from telenano.runtime.loop.node import Node, NodeContext
from telenano.runtime.wiring.participant import OBSERVER, Participant, StopSignals
from telenano.testing import VirtualClock
from telenano.wire.errors import ConfigError, EndpointError
from telenano.wire.received import Received

HAND, LINK = "haptic_node@master", "delay_node@master"


@pytest.fixture
def book(tmp_path: Path) -> AddressBook:
    return AddressBook(nodes={node: f"ipc://{tmp_path}/{node}" for node in (HAND, LINK, "controller@master")})


@pytest.fixture
def signals() -> Iterator[StopSignals]:
    made = StopSignals()
    yield made
    os.close(signal.set_wakeup_fd(-1))
    os.close(made.descriptor)


class Idle(Node):
    """A node that waits; a patient one goes on after a signal, until its next deadline."""

    inputs: ClassVar[tuple[str, ...]] = ("session/control",)

    def __init__(self, context: NodeContext, *, patient: bool = False) -> None:
        super().__init__(context)
        self.patient = patient
        self.log: list[str] = []

    def on_message(self, received: Received) -> None:
        raise AssertionError(f"nobody sends {received.topic}")

    def interrupt(self) -> None:
        self.log.append("interrupt")
        if not self.patient:
            super().interrupt()

    def deadline_ns(self) -> int:
        return self.clock.monotonic_ns() if self.patient else super().deadline_ns()

    def on_deadline(self, now_ns: int) -> None:
        self.context.request_stop()

    def make_safe(self) -> None:
        self.log.append("safe")


def test_what_was_opened_is_closed_connections_first(book: AddressBook) -> None:
    order: list[str] = []
    with Participant.open(HAND, book) as participant:
        bus = participant.bus(["session/control", "haptic/command"])
        extra = participant.bind(LINK, zmq.XPUB)
        sockets = [subscriber.socket for subscriber in bus.subscribers]
        participant.resources.callback(lambda: order.append(f"open {not sockets[0].closed}"))
        assert participant.network.machine == "master"
    assert order == ["open True"]
    assert sockets
    assert all(socket.closed for socket in [*sockets, extra.socket])
    # the endpoint is free again
    with Participant.open(HAND, book) as again:
        again.bind(HAND)


def test_an_endpoint_that_is_taken_leaves_nothing_open(book: AddressBook) -> None:
    with Participant.open(LINK, book) as holder:
        holder.bind(LINK)
        with pytest.raises(EndpointError, match=f"{LINK} is in use by process {os.getpid()}"), \
                Participant.open(HAND, book) as participant:  # fmt: skip
            first = participant.bind(HAND)
            participant.bind(LINK)
        assert first.socket.closed


def test_a_node_needs_a_place_in_the_site_file_and_an_observer_none(book: AddressBook) -> None:
    with pytest.raises(EndpointError, match="afm_node@slave is not in the site file"), \
            Participant.open("afm_node@slave", book):  # fmt: skip
        pass
    with Participant.observing(book) as observer:
        readers = observer.observe(lambda topic, node: topic == "haptic/state" and node.endswith("@master"))
        assert {node: reader.topics for node, reader in readers.items()} == {HAND: ["haptic/state"]}
        assert observer.observe(lambda topic, node: True, ["slave"]) == {}


def test_without_a_key_that_the_rig_needs_nothing_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path))
    locked = AddressBook.model_validate({"nodes": {HAND: "tcp://127.0.0.1:5701"}})
    with pytest.raises(ConfigError, match="`telenano keys new master` creates one"), Participant.open(HAND, locked):
        pass


def idle_of(participant: Participant, *, patient: bool = False) -> Idle:
    return Idle(participant.context(participant.bus(Idle.inputs)), patient=patient)


def test_a_signal_before_there_is_a_loop_stops_it(book: AddressBook, signals: StopSignals) -> None:
    signal.raise_signal(signal.SIGTERM)
    with Participant.open(HAND, book, signals.descriptor) as participant:
        bus = participant.bus(Idle.inputs)
        node = Idle(participant.context(bus))
        signals.run(node, bus, freeze=False)
    assert node.log == ["interrupt", "safe"]


def test_a_node_that_goes_on_after_a_signal_can_wait_again(book: AddressBook, signals: StopSignals) -> None:
    signal.raise_signal(signal.SIGINT)
    assert select.select([signals.descriptor], (), (), 0)[0]
    with Participant.open(HAND, book, signals.descriptor) as participant:
        node = idle_of(participant, patient=True)
        signals.interrupt(node)
        assert not select.select([signals.descriptor], (), (), 0)[0]
        signal.raise_signal(signal.SIGTERM)
        assert not select.select([signals.descriptor], (), (), 0)[0]
        assert node.log == ["interrupt", "interrupt"]
        # one that is to stop leaves it readable: the wait in which the signal came has to end
        node.patient = False
        signal.raise_signal(signal.SIGTERM)
        assert select.select([signals.descriptor], (), (), 0)[0]
    assert node.context.stop_requested


@pytest.mark.parametrize("spans_machines", [True, False])
def test_health_that_crosses_to_another_machine_is_brief(*, spans_machines: bool) -> None:
    publisher = NullPublisher(VirtualClock(), "n@s")
    made: dict[str, bool] = {}
    for key in ("afm_node@slave", "launcher@slave", "haptic_node@master"):
        part: Any = SimpleNamespace(
            key=key,
            book=SimpleNamespace(spans_machines=spans_machines),
            clock=VirtualClock(),
            wake_descriptor=-1,
            network=None,
            batches=[],
        )
        made[key] = Participant.bus_of(part, publisher, []).is_brief
    assert [key for key, is_brief in made.items() if is_brief] == (
        ["afm_node@slave", "launcher@slave"] if spans_machines else []
    )


def test_a_null_publisher_numbers_and_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    publisher = NullPublisher(VirtualClock(), OBSERVER)
    event = {"id": "", "kind": "mark", "level": "info", "text": "here", "data": {}}
    sent = [publisher.publish("session/event", **event) for _ in range(2)]
    assert [(message.seq, message.src) for message in sent] == [(0, OBSERVER), (1, OBSERVER)]
    with pytest.raises(ValueError, match="level"):
        publisher.publish("session/event", **{**event, "level": "loud"})
    assert publisher.publish("session/event", **event).seq == 2


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of sockets, which is not made yet."""
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    return tmp_path / "run"


@pytest.fixture
def private_book() -> AddressBook:
    return AddressBook(nodes={node: f"ipc://{{runtime}}/{node}" for node in (HAND, LINK, "controller@master")})


def refusal_of(book: AddressBook, *, publisher: bool) -> str:
    with (
        pytest.raises(ConfigError) as caught,
        Participant.open(HAND if publisher else OBSERVER, book, publisher=publisher) as participant,
    ):
        participant.bind(HAND)
    return str(caught.value)


def test_the_folder_of_sockets_is_made_for_this_user_alone(folder: Path, private_book: AddressBook) -> None:
    with Participant.observing(private_book):
        assert not folder.exists()
    before = os.umask(0)
    try:
        with Participant.open(HAND, private_book) as participant:
            participant.bind(HAND)
            assert folder.stat().st_mode & 0o777 == 0o700
    finally:
        os.umask(before)


@pytest.mark.parametrize("publisher", [True, False])
@pytest.mark.parametrize("mode", [0o750, 0o701, 0o777, 0o1777])
def test_a_folder_of_sockets_that_others_can_reach_is_refused(
    folder: Path, private_book: AddressBook, mode: int, publisher: bool
) -> None:
    folder.mkdir()
    folder.chmod(mode)
    assert refusal_of(private_book, publisher=publisher) == (
        f"{folder}: other users can reach its content (mode {mode & 0o777:o}): chmod 700 {folder}"
    )
    assert list(folder.iterdir()) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")
@pytest.mark.parametrize("publisher", [True, False])
@pytest.mark.parametrize("link", ["to a folder of one's own", "to nothing", ""])
def test_a_folder_of_sockets_of_another_user_is_refused(
    folder: Path, private_book: AddressBook, publisher: bool, link: str
) -> None:
    if link:
        if link != "to nothing":
            (folder.parent / "own").mkdir(mode=0o700)
        folder.symlink_to(folder.parent / "own")
    else:
        folder.mkdir(mode=0o700)
    os.chown(folder, 65534, -1, follow_symlinks=False)
    assert refusal_of(private_book, publisher=publisher) == (
        f"{folder}: belongs to user 65534, and this is user {os.geteuid()}: name another one by TELENANO_RUNTIME_DIR"
    )


def test_a_folder_that_somebody_makes_in_the_last_moment_is_refused(
    folder: Path, private_book: AddressBook, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = Path.mkdir

    def too_late(path: Path, *arguments: int, **more: bool) -> None:
        make(path)
        path.chmod(0o777)
        raise FileExistsError(17, "File exists")

    with Participant.open(HAND, private_book) as participant:
        monkeypatch.setattr(Path, "mkdir", too_late)
        with pytest.raises(ConfigError, match="other users can reach its content"):
            participant.bind(HAND)


def test_sockets_that_the_site_file_puts_elsewhere_are_its_own_affair(
    folder: Path, book: AddressBook, tmp_path: Path
) -> None:
    folder.mkdir(mode=0o777)
    tmp_path.chmod(0o755)
    with Participant.open(HAND, book) as participant:
        participant.bind(HAND)

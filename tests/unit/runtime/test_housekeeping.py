"""What a loop does beside its turns may be refused by the system: that is said, and the loop goes on."""

import errno
import io
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NoReturn

import pytest
import zmq
from test_memory_without_descriptors import room_for
from test_runtime_node import GRANTED, MS, Probe, Rig

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ZmqBus
from telenano.runtime.bus.places import Places
from telenano.runtime.loop.housekeeping import Housekeeping
from telenano.runtime.loop.kept_stop import keep, kept
from telenano.runtime.loop.log import StructuredLog, configure_logging
from telenano.runtime.loop.machine import OwnMachine
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.runtime.wiring.transport import Transport, open_context
from telenano.settings import DEFAULT_SITE_FILE
from telenano.testing import payload
from telenano.timing.clock import SystemClock
from telenano.wire.journal_messages import NodeJournal

ERRNOS = (errno.EMFILE, errno.ENOMEM, errno.EIO, errno.ENOSPC)
ERRORS = (*(OSError(number, os.strerror(number)) for number in ERRNOS), zmq.ZMQError(errno.EMFILE), MemoryError())


class Refused:
    """Refuses something with an error while `error` is set."""

    def __init__(self) -> None:
        self.error: BaseException | None = None

    def before(self, call: Callable[..., Any], only: Callable[..., bool] = lambda *given: True) -> Callable[..., Any]:
        def instead(*given: Any, **named: Any) -> Any:
            if self.error is not None and only(*given):
                raise self.error
            return call(*given, **named)

        instead.__name__ = getattr(call, "__name__", "call")
        return instead


class Removed:
    """A path that was removed and is there again at once."""

    def lost(self) -> str:
        return "/run/x"

    def make_again(self) -> None:
        """It is there again."""


class Recorded(Probe):
    """A probe whose turns are in a journal."""

    journalled = True


class Kept(Rig):
    """A loop with everything that one may look after, and a machine, a bus and paths that refuse on request."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.refused = Refused()
        self.machine = OwnMachine()
        context = self.node.context
        context.machine, context.kept_stop, context.places = self.machine, folder / "x.kept", Places()
        self.place = Removed()
        context.places.add(self.place)
        self.node = Recorded(context, MS)
        self.loop = NodeLoop(self.node, self.bus, GRANTED)

    def told(self, state: str) -> list[str]:
        return [str(event.data["task"]) for event in self.events if event.data.get("state") == state]


def connections(*, now: bool) -> Callable[[Kept], None]:
    def plant(rig: Kept) -> None:
        process = rig.bus.process_events

        def instead(**named: bool) -> Any:
            if rig.refused.error is not None and named.get("now", False) == now:
                raise rig.refused.error
            return process(**named)

        rig.bus.process_events = instead  # type: ignore[method-assign]

    return plant


def processor_time(rig: Kept) -> None:
    rig.machine.processor_time_s = rig.refused.before(rig.machine.processor_time_s)  # type: ignore[method-assign]


def process(rig: Kept) -> None:
    rig.machine.health = rig.refused.before(rig.machine.health)  # type: ignore[method-assign]


def paths(rig: Kept) -> None:
    rig.place.lost = rig.refused.before(rig.place.lost)  # type: ignore[method-assign]


def kept_stop(rig: Kept) -> None:
    latch = rig.loop._commands.latch
    latch.kept = rig.refused.before(latch.kept)  # type: ignore[method-assign]


def publishing(topic: str) -> Callable[[Kept], None]:
    def plant(rig: Kept) -> None:
        rig.node.publish = rig.refused.before(rig.node.publish, lambda name: name == topic)  # type: ignore[method-assign]

    return plant


def counting(rig: Kept) -> None:
    rig.bus.input_health = rig.refused.before(rig.bus.input_health)  # type: ignore[method-assign]


def telling(rig: Kept) -> None:
    rig.node.on_place = rig.refused.before(rig.node.on_place)  # type: ignore[method-assign]


def batches(rig: Kept) -> None:
    assert rig.loop._journal is not None
    rig.loop._journal.complete = rig.refused.before(rig.loop._journal.complete)  # type: ignore[method-assign]


# Each task of the housekeeping, and how the system comes to refuse it.
TASKS: Mapping[str, Callable[[Kept], None]] = {
    "the answer to events of connections": connections(now=False),
    "the look at connections": connections(now=True),
    "the look at the paths of this process": paths,
    "the look for a kept emergency stop": kept_stop,
    "the measurement of processor time": processor_time,
    "the measurement of this process": process,
    "the task 'measure health'": counting,
    "the task 'send health'": publishing("node/health"),
    "the task 'look after places'": telling,
    "the task 'complete batch'": batches,
    "the task 'publish journal'": publishing("node/journal"),
}


@pytest.mark.parametrize("error", ERRORS, ids=repr)
@pytest.mark.parametrize("task", TASKS)
def test_what_the_system_refuses_beside_the_loop_is_not_known_and_said_once(
    tmp_path: Path, task: str, error: BaseException
) -> None:
    rig = Kept(tmp_path)
    TASKS[task](rig)
    rig.run_until(1100 * MS)
    assert rig.told("not_known") == []
    rig.refused.error = error
    steps = rig.node.steps
    rig.run_until(3100 * MS)
    assert rig.node.steps - steps == 2000
    assert (rig.told("not_known"), rig.told("known")) == ([task], [])
    rig.refused.error = None
    before = len(rig.health)
    rig.run_until(4700 * MS)
    assert (rig.told("not_known"), rig.told("known")) == ([task], [task])
    assert len(rig.health) - before == 3
    turns = sum(len(batch.kind.to_numpy()) for batch in rig.bus.of(NodeJournal))
    assert turns >= 4500, "turns are missing in the journal"


def test_the_table_has_all_that_a_loop_does_beside_its_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, attempt, process_events = set[str](), Housekeeping.attempt, Housekeeping.process_events

    def noted(self: Housekeeping, what: str, task: Callable[[], Any], otherwise: Any) -> Any:
        found.add(what)
        return attempt(self, what, task, otherwise)

    def processed(self: Housekeeping) -> None:
        found.add("the answer to events of connections")
        process_events(self)

    monkeypatch.setattr(Housekeeping, "attempt", noted)
    monkeypatch.setattr(Housekeeping, "process_events", processed)
    rig = Kept(tmp_path)
    rig.run_until(2100 * MS)
    assert found == TASKS.keys()


def test_a_fault_of_the_node_itself_ends_it_as_ever(tmp_path: Path) -> None:
    rig = Kept(tmp_path)

    def fail() -> NoReturn:
        raise OSError(errno.EIO, "the device is gone")

    rig.node.defer(fail)
    with pytest.raises(OSError, match="the device is gone"):
        rig.loop.run()
    assert rig.node.made_safe == 1


def test_an_end_without_a_report_is_an_end(tmp_path: Path) -> None:
    rig = Kept(tmp_path)
    publishing("node/health")(rig)
    rig.run_until(600 * MS)
    rig.refused.error = OSError(errno.ENOSPC, "full")
    rig.node.context.request_stop()
    rig.loop.run()
    assert (rig.node.made_safe, rig.events[-1].text.startswith("controller@master has ended")) == (1, True)


class Full(io.StringIO):
    """A file on a full disk."""

    def write(self, text: str) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_log_on_a_full_disk_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", Full())
    configure_logging()
    StructuredLog("afm_node@slave").warning("the tip is in contact", force_n=1e-9)


# --- a stop that is kept ---


def test_a_stop_that_is_kept_is_found_without_a_descriptor_and_none_is_made_up(tmp_path: Path) -> None:
    path = tmp_path / "x.kept"
    with room_for(0):
        assert kept(path) is None
    assert keep(path, b"stop") == ""
    with room_for(0):
        assert kept(path) == b"", "a stop that cannot be read is a stop"
    assert kept(path) == b"stop"


def test_a_broken_disk_is_no_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Path, **given: Any) -> NoReturn:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    for call in ("stat", "lstat"):
        monkeypatch.setattr(Path, call, broken)
    with pytest.raises(OSError, match="Input/output error"):
        kept(tmp_path / "x.kept")


# --- with real sockets ---


class Connected:
    """A loop with sockets, that reads the hand."""

    HAND = "haptic_node@master"

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", folder: Path) -> None:
        self.clock, book = SystemClock(), AddressBook.load(DEFAULT_SITE_FILE)
        self.context, self.endpoint = context, book.local_endpoint(self.HAND) or ""
        self.network = Transport(context, self.clock, book, "")
        self.publisher = self.network.publisher("controller@master")
        self.readers = self.network.subscribers({self.HAND: ["haptic/state"]}, newest_only=True)
        self.wake = os.pipe()
        self.bus = ZmqBus(self.publisher, self.readers, self.clock, self.wake[0], self.network)
        self.told: list[dict[str, Any]] = []
        publish = self.bus.publish

        def noted(topic: str, **fields: Any) -> Any:
            if topic == "session/event":
                self.told.append(fields)
            return publish(topic, **fields)

        self.bus.publish = noted  # type: ignore[method-assign]
        log = StructuredLog("controller@master")
        parts = {"places": self.network.places, "hearing": self.network.hearing, "kept_stop": folder / "x.kept"}
        node_context = NodeContext("controller@master", self.clock, self.bus, log, **parts)  # type: ignore[arg-type]
        self.node = Probe(node_context, 10 * MS)
        self.loop = NodeLoop(self.node, self.bus, GRANTED)

    def run_for(self, duration_s: float, act: Callable[[], object] = lambda: None) -> int:
        """Let the loop run for a time; return the number of its steps."""
        before, end_ns = self.node.steps, self.clock.monotonic_ns() + round(duration_s * 1e9)
        while self.clock.monotonic_ns() < end_ns:
            self.loop.turn()
            act()
        return self.node.steps - before

    def close(self) -> None:
        self.network.close()
        for each in (*self.readers, self.publisher):
            each.close()
        for end in self.wake:
            os.close(end)


@pytest.fixture
def connected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Connected]:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "r"))
    monkeypatch.delenv("TELENANO_RIG", raising=False)
    with open_context(serves_network=False) as context:
        with closing(Connected(context, tmp_path)) as made:
            yield made
        context.destroy(0)


@pytest.mark.check("takes 8 s")
def test_a_loop_without_a_descriptor_left_goes_on_and_hears_again_what_it_had_lost(connected: Connected) -> None:
    with connected.context.socket(zmq.PUB) as hand:
        hand.bind(connected.endpoint)
        numbers = iter(range(10**6))

        def send() -> None:
            hand.send_multipart([b"haptic/state", payload("haptic/state", connected.HAND, next(numbers))])

        connected.run_for(1.0, send)
        assert connected.node.messages
        # libzmq gives the connection up for good
        hand.send_multipart([b"haptic/state", bytes(20 << 20)])
        with room_for(0):
            steps = connected.run_for(2.5)
        assert steps >= 200
        told = [event["data"]["task"] for event in connected.told if event["data"].get("state") == "not_known"]
        assert told == ["the look at connections"]
        connected.node.messages.clear()
        connected.run_for(2.5, send)
        assert connected.node.messages
        states = [event["data"].get("state") or event["data"].get("connection") for event in connected.told]
        # The look that finds no descriptor may have reported the connection before.
        assert sorted(map(str, states)) == ["deaf", "known", "not_known", "up"]
        assert states.index("not_known") < states.index("known") and states.index("deaf") < states.index("up")

"""The view on a real bus of this machine: what it receives while a page is open, and the force that it publishes."""

import math
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import msgpack
import numpy as np
import pytest
from recorder_samples import sample

from services.viz_node.feed import SeenMessage
from services.viz_node.hub import Hub
from services.viz_node.live import LiveSource
from services.viz_node.page_session import Session
from telenano.console import RigHand
from telenano.console.send_commands import send_control
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.commands import Command
from telenano.runtime.wiring.observer import Observer
from telenano.runtime.wiring.participant import Participant
from telenano.serving.access import Role
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire.codec import fields_of
from telenano.wire.errors import RigError, TelenanoError
from telenano.wire.messages import Array
from telenano.wire.nodes import TIP


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # a socket's path is short by law, pytest's folders are not
    with tempfile.TemporaryDirectory(prefix="tnv-") as folder:
        monkeypatch.setenv("TELENANO_RUNTIME_DIR", folder)
        yield


@pytest.fixture
def instrument() -> Iterator[ZmqPublisher]:
    with Participant.open(TIP, AddressBook.load(DEFAULT_SITE_FILE)) as participant:
        yield participant.bind(TIP)


def fields(topic: str) -> dict[str, Any]:
    return {key: value for key, value in fields_of(sample(topic, 0)).items() if key not in ("seq", "t_ns", "src", "v")}


def received(source: LiveSource, watched: bool, send: Callable[[], object], wanted: int = 5) -> list[SeenMessage]:
    """Send and poll in turns until so many messages have come, or long enough that none will."""
    found: list[SeenMessage] = []
    for _ in range(200):
        send()
        found += source.poll(watched=watched)
        if len(found) >= wanted:
            break
        time.sleep(0.005)
    return found


def test_the_loop_is_subscribed_to_only_while_a_page_is_open(instrument: ZmqPublisher) -> None:
    state, event = fields("afm/state"), fields("session/event")

    def send() -> None:
        instrument.publish("afm/state", **state)
        instrument.publish("session/event", **event)

    with closing(LiveSource(AddressBook.load(DEFAULT_SITE_FILE), "local")) as source:
        assert {seen.topic for seen in received(source, False, send)} == {"session/event"}
        assert {seen.topic for seen in received(source, True, send, wanted=20)} == {"session/event", "afm/state"}
        # what was sent before the page was closed may still be on the way
        received(source, False, send, wanted=20)
        assert {seen.topic for seen in received(source, False, send)} == {"session/event"}


def test_what_is_no_message_is_left_out(instrument: ZmqPublisher) -> None:
    event = fields("session/event")

    def send() -> None:
        times = (math.inf, math.nan, -math.inf, "now", None)
        wrong = [msgpack.packb({"src": TIP, "t_ns": t_ns, "seq": 0}) for t_ns in times]
        for payload in (b"", b"\xc1", b"\x80", b"\x93\x01\x02\x03", *wrong):
            instrument.send("session/event", payload)
        instrument.publish("session/event", **event)

    with closing(LiveSource(AddressBook.load(DEFAULT_SITE_FILE), "local")) as source:
        assert all(seen.src == TIP for seen in received(source, True, send))


def scanline(line: int) -> dict[str, Any]:
    """Return a line of an image of 4 x 3 points over 30 nm."""
    y_m = line * 10e-9
    return {
        "line": line,
        "lines": 3,
        "direction": "trace",
        "start_m": (0.0, y_m, 0.0),
        "end_m": (30e-9, y_m, 0.0),
        "height_m": Array.from_numpy(np.full(4, line * 1e-9)),
        "amplitude_m": None,
        "phase_rad": None,
    }


def test_an_image_reaches_a_page_line_by_line_and_whole_a_page_that_comes_later(instrument: ZmqPublisher) -> None:
    with closing(LiveSource(AddressBook.load(DEFAULT_SITE_FILE), "local")) as source:
        hub = Hub(source)
        page = hub.join(Role.OBSERVER)
        event = fields("session/event")
        # until the connection is there: what is published before it reaches nobody
        assert received(source, True, lambda: instrument.publish("session/event", **event))
        for line in range(3):
            instrument.publish("afm/scanline", **scanline(line))
            assert lines_told(hub, page) == [line]
        later = msgpack.unpackb(hub.snapshot(page))["lines"]
        assert [found["line"] for found in later] == [0, 1, 2]
        assert np.frombuffer(later[2]["height"]["data"], "<f8").tolist() == [2e-9] * 4


def lines_told(hub: Hub, page: Session) -> list[int]:
    """Return the numbers of the lines that the next frames with lines have."""
    end = time.monotonic() + 10.0
    while time.monotonic() < end:
        hub.tick()
        while page._frames:
            frame = msgpack.unpackb(page._frames.popleft())
            if frame["k"] == "tick" and frame.get("lines"):
                return [line["line"] for line in frame["lines"]]
        time.sleep(0.002)
    return []


def test_the_force_of_the_page_is_on_its_topic_along_the_axis_of_the_hand() -> None:
    with closing(Observer(AddressBook.load(DEFAULT_SITE_FILE), ["operator/force"])) as observer:
        hand = RigHand(DEFAULT_SITE_FILE)
        end = time.monotonic() + 10.0
        message: Any = None
        while message is None and time.monotonic() < end:
            hand.push(1.5)
            message = next((seen.received.message for seen in observer.listen(0.02)), None)
        assert message is not None
        assert (message.src, message.force_n) == ("view@master", (0.0, 0.0, -1.5))
        with pytest.raises(TelenanoError, match="in use by process"):
            RigHand(DEFAULT_SITE_FILE)
        hand.close()


def test_a_command_that_is_given_up_is_not_sent_again(instrument: ZmqPublisher) -> None:
    wanted = [True] * 3

    def is_wanted() -> bool:
        return bool(wanted and wanted.pop())

    with pytest.raises(RigError, match="arm was given up before all had answered"):
        send_control(Command("arm", "afm_node"), DEFAULT_SITE_FILE, "master", lambda event: None, is_wanted)
    assert wanted == []

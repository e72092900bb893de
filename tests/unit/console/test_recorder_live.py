"""The live rig and the file give the same messages through the same iterator."""

import threading
from pathlib import Path

import pytest
import zmq
from recorder_samples import haptic_state, teleop_forward

from telenano.console.live_recording import LiveRecording
from telenano.recording.messages import RecordedMessage
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.timing.clock import SystemClock
from telenano.wire import encode
from telenano.wire.errors import ConfigError

HAND, FAR = "haptic_node@master", "delay_node@slave"


def test_a_live_rig_is_read_like_a_recording(tmp_path: Path) -> None:
    book = AddressBook(nodes={node: f"ipc://{tmp_path}/{node}" for node in (HAND, FAR)})
    done = threading.Event()
    with zmq.Context() as context:
        publishers = [ZmqPublisher(context, SystemClock(), node, book.endpoint(node)) for node in (HAND, FAR)]

        def publish() -> None:
            seq = 0
            while not done.wait(0.002):
                publishers[0].send("haptic/state", encode(haptic_state(seq)))
                publishers[0].send("haptic/state", b"\xc1")
                publishers[1].send("teleop/forward", encode(teleop_forward(seq)))
                seq += 1

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            with LiveRecording(book) as live:
                found: dict[str, RecordedMessage] = {}
                for message in live.messages(duration_s=20.0):
                    found[message.channel_topic] = message
                    if len(found) == 2:
                        break
                channels = {channel.channel_topic for channel in live.channels}
        finally:
            done.set()
            thread.join()
            for publisher in publishers:
                publisher.close()
    assert channels == {"haptic/state", "teleop/forward@slave"}
    hand, forward = found["haptic/state"], found["teleop/forward@slave"]
    assert hand.decode() == haptic_state(hand.seq)
    assert hand.publish_ns == haptic_state(hand.seq).t_ns
    assert (forward.site, forward.via, forward.src) == ("slave", "link", "controller@master")


def test_a_rig_with_keys_is_not_received_without_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path))
    monkeypatch.setenv("TELENANO_MACHINE", "laptop")
    with pytest.raises(ConfigError, match="`telenano keys new laptop` creates one"):
        LiveRecording(AddressBook.model_validate({"nodes": {HAND: "tcp://127.0.0.1:5701"}}))

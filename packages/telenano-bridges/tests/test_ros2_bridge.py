"""What a second process of ROS 2 receives from the bridge: over zenoh, as rmw_zenoh names and encodes it."""

import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from telenano_bridges.ros2 import Ros2Bridge, close_session, is_connected, zenoh_publishers

from telenano.testing import hand_state, numbered, received
from telenano.wire import ConfigError

zenoh = pytest.importorskip("zenoh")
typesys = pytest.importorskip("rosbags.typesys")
# The threads of zenoh outlive its sessions, and the other tests of a worker have processes forked beside them.
pytestmark = pytest.mark.endurance
WAIT_S = 20.0


class Kept:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, dict[str, Any]]] = []

    def __call__(self, topic: str, kind: str, definition: str, type_hash: str) -> Any:
        kept = self

        class Publisher:
            def publish(self, **fields: Any) -> None:
                kept.sent.append((topic, fields))

            def close(self) -> None:
                kept.sent.append((topic, {}))

        return Publisher()


def test_events_are_never_left_out_and_copies_always() -> None:
    kept = Kept()
    events = [
        received("session/event", numbered("session/event", i), i, site) for i in range(5) for site in ("", "master")
    ]
    bridge = Ros2Bridge(kept, "lab")
    bridge.run(events)
    bridge.close()
    assert [topic for topic, _ in kept.sent] == ["/lab/session/event"] * 6
    assert kept.sent[-1][1] == {}


def test_what_cannot_be_read_is_left_out() -> None:
    kept = Kept()
    whole = received("haptic/state", hand_state(1), 1)
    Ros2Bridge(kept).run([whole._replace(payload=b"\xc1"), whole._replace(payload=b"\x80"), whole])
    assert [topic for topic, _ in kept.sent].count("/hand/measured_cp") == 1


@pytest.mark.parametrize("router", ["here", ":7447", "host:0", "host:65536", "host:x"])
def test_an_address_that_is_none_is_refused(router: str) -> None:
    with pytest.raises(ConfigError, match=r"--router .* must be host:port"):
        zenoh_publishers(router, 0)


@pytest.fixture
def router() -> Iterator[tuple[str, Any]]:
    """A second session of zenoh on this machine, in the place of the router of rmw_zenoh."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/{address}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    yield address, session
    session.close()


def test_another_process_of_ros_sees_the_topic_and_reads_the_message(router: tuple[str, Any]) -> None:
    address, session = router
    arrived, found = threading.Event(), []

    def on_sample(received: Any) -> None:
        found.append((str(received.key_expr), bytes(received.payload)))
        arrived.set()

    subscriber = session.declare_subscriber("7/hand/measured_cp/**", on_sample)
    bridge = Ros2Bridge(zenoh_publishers(address, 7))
    try:
        end_s = time.monotonic() + WAIT_S
        while not arrived.is_set() and time.monotonic() < end_s:
            bridge.run([received("haptic/state", hand_state(3), 3)])
            arrived.wait(0.05)
        assert is_connected()
        tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/7/**")]
        assert any("/MP/" in token and "%hand%measured_cp" in token for token in tokens)
    finally:
        bridge.close()
        close_session()
        subscriber.undeclare()
    key, payload = found[0]
    ros = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kind = "geometry_msgs/msg/PoseStamped"
    assert key == f"7/hand/measured_cp/geometry_msgs::msg::dds_::PoseStamped_/{ros.hash_rihs01(kind)}"
    message: Any = ros.deserialize_cdr(payload, kind)
    state = hand_state(3)
    assert (message.pose.position.x, message.pose.position.y, message.pose.position.z) == state.position_m
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == state.t_ns

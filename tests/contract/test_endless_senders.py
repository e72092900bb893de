"""The other side never stops sending: each loop that reads ends by its own bound, and says so where it must.

A loop whose bound is undone takes more than its bound here, or goes on beyond a time that none of them needs.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zmq
from telenano_devices.impedance import servo_process, vendor_service
from telenano_devices.nanonis import nanonis_client
from telenano_lab.experiments.bus import ExperimentBus
from telenano_lab.networks import udp_ports
from telenano_wide_area.relay import forwarder

from services.player import node as player
from services.viz_node import live
from telenano.console import emergency_stop
from telenano.console import send_commands as command_client
from telenano.console.live_recording import LiveRecording
from telenano.extend.hands import DeviceError as HandError
from telenano.extend.instruments import DeviceError
from telenano.files import limited_child
from telenano.runtime.security import zap_authenticator
from telenano.runtime.wiring.observer import Observer
from telenano.testing.conformance import examination

# far beyond what any of these loops needs, and before the limit of a test [s]
PATIENCE_S = 60.0
# A loop that waits for a time is given this much of it here [s].
SHORT_S = 0.05


class Endless:
    """A socket, a reader or a poller of which there is always more to take."""

    def __init__(self, given: Any, most: float = float("inf")) -> None:
        self.given, self.most, self.taken = given, most, 0
        self.end_s = time.monotonic() + PATIENCE_S
        self.drained = False

    def take(self, *ignored: Any, **options: Any) -> Any:
        self.taken += 1
        assert self.taken <= self.most, "a turn takes more than its bound"
        assert time.monotonic() < self.end_s, "the loop has no end of its own"
        return self.given

    recv = recvfrom = recv_multipart = receive = receive_raw = take

    def poll(self, timeout: float = 0) -> list[tuple[Any, int]]:
        """Return what is readable: always, but where nobody waits for it."""
        return [] if timeout < 0 else [(self, zmq.POLLIN)]

    def get(self, option: int) -> int:
        return int(zmq.POLLIN)

    def fileno(self) -> int:
        return -1

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments, **options: None


def made(kind: type[Any], **attributes: Any) -> Any:
    """Make an object without what it opens."""
    found = kind.__new__(kind)
    for name, value in attributes.items():
        setattr(found, name, value)
    return found


Patch = pytest.MonkeyPatch
SUBSCRIBED = b"\x01session/control"


def console_subscriptions(patch: Patch, folder: Path) -> None:
    command_client._new_subscriptions(SimpleNamespace(socket=Endless(SUBSCRIBED, 256)))  # type: ignore[arg-type]


def inlet_subscriptions(patch: Patch, folder: Path) -> None:
    made(emergency_stop._Inlet, ready=False, _whole=False, _taken=0, socket=Endless(b"\x01", 256)).read_subscription(0)


def player_subscriptions(patch: Patch, folder: Path) -> None:
    publisher = SimpleNamespace(socket=Endless(SUBSCRIBED, 256))
    made(player.ReplayPublisher, publisher=publisher, subscriptions=set(), was_read=False).read_subscriptions()


def kit_subscriptions(patch: Patch, folder: Path) -> None:
    made(examination._Rig, _socket=Endless(SUBSCRIBED, 1000), topics=set(), _subscribed_s=0.0).read_subscriptions()


def kit_events(patch: Patch, folder: Path) -> None:
    patch.setattr(examination, "recv_monitor_message", lambda monitor: monitor.take())
    examination._connection_events(examination.Account(), Endless({"event": 0}, 1000), 0.0, 0.0)  # type: ignore[arg-type]


def kit_stranger(patch: Patch, folder: Path) -> None:
    monitor = Endless({"event": 0})
    patch.setattr(examination, "_HANDSHAKE_S", SHORT_S)
    patch.setattr(examination, "recv_monitor_message", lambda monitor: monitor.take())
    patch.setattr(monitor, "poll", lambda timeout: timeout > 0, raising=False)
    examination._stranger(examination.Account(), monitor)  # type: ignore[arg-type]


def service_of_a_handle(patch: Patch, folder: Path) -> None:
    endless = Endless(True, 64)
    patch.setattr(vendor_service.select, "select", lambda readers, *rest: (readers, [], []))
    conversation = made(
        vendor_service.Conversation, _socket=endless, _service="service", _messages=[], _receive=endless.take
    )
    with pytest.raises(HandError, match="sends faster than it is read"):
        conversation.drop()


def datagrams_of_clients(patch: Patch, folder: Path) -> None:
    listener = Endless((b"datagram", ("127.0.0.1", 1)), 64)
    client = udp_ports.Client(("127.0.0.1", 1), Endless(b""))  # type: ignore[arg-type]
    ports = made(
        udp_ports.UdpPorts, _listener=listener, clients={"127.0.0.1:1": client}, take=lambda *given: None,
        _monotonic_ns=lambda: 0, refused=0,
    )  # fmt: skip
    ports._take_from_clients()
    assert not ports.drained


def datagrams_of_the_target(patch: Patch, folder: Path) -> None:
    client = udp_ports.Client(("127.0.0.1", 1), Endless(b"datagram", 64))  # type: ignore[arg-type]
    ports = made(udp_ports.UdpPorts, take=lambda *given: None)
    ports._take_answers("127.0.0.1:1", client)
    assert not ports.drained


def datagrams_at_a_relay(patch: Patch, folder: Path) -> None:
    socket = Endless((b"datagram", ("127.0.0.1", 1)), forwarder._BATCH)
    made(forwarder.Forwarder, _socket=socket, take=lambda *given: None, refused={})._read()


def handshakes(patch: Patch, folder: Path) -> None:
    authenticator = made(zap_authenticator.ZapAuthenticator, _reply_to=lambda frames: frames)
    assert authenticator._answer(Endless([b""], zap_authenticator._BATCH))


def messages_for_pages(patch: Patch, folder: Path) -> None:
    source = made(
        live.LiveSource, _watched=True, _network=Endless(None), subscribers={"afm_node@slave": Endless([], 8)}
    )
    assert list(source.poll(watched=True)) == []


def messages_of_a_rig(patch: Patch, folder: Path) -> None:
    endless = Endless([SimpleNamespace(topic="afm/state", message=SimpleNamespace(src="afm_node@slave"))])
    observer = made(
        Observer, _poller=Endless(None), _network=Endless(None), notices=[], subscribers={"afm_node@slave": endless}
    )
    patch.setattr(observer._network, "process_events", lambda: [], raising=False)
    assert list(observer.listen(SHORT_S))


def messages_for_a_recorder(patch: Patch, folder: Path) -> None:
    patch.setattr(zmq, "Poller", lambda: Endless(None))
    listener = SimpleNamespace(subscriber=Endless([([b"afm/state", b""], 0)]), publisher="afm_node@slave")
    listener.subscriber.socket = None
    recording = made(LiveRecording, _listeners=[listener], _network=Endless(None), _message=lambda *given: None)
    assert list(recording.messages(duration_s=SHORT_S)) == []


def answers_of_participants(patch: Patch, folder: Path) -> None:
    patch.setattr(zmq, "select", lambda *given: None)
    endless = Endless([])
    bus = made(ExperimentBus, _subscribers=[SimpleNamespace(socket=None)], answers=endless.take)
    assert bus.wait("c-1", SHORT_S) is None


def answers_of_a_controller(patch: Patch, folder: Path) -> None:
    patch.setattr(nanonis_client, "_ANSWER_S", SHORT_S)
    client = made(
        nanonis_client.NanonisClient, _line=Endless(b"\0"), _incoming=SimpleNamespace(take=lambda: None, add=len),
        _where="afm_node.nanonis",
    )  # fmt: skip
    with pytest.raises(DeviceError, match="timed out"):
        client.call("ZCtrl.OnOffGet")


class Servo(servo_process.ProcessLink):
    """A servo that writes without end, and never a whole line."""

    def _start(self) -> None:
        reader, self.writer = os.pipe()
        self._process = SimpleNamespace(stdout=os.fdopen(reader, "rb", 0))  # type: ignore[assignment]
        self.part = b"x" * 65_536 if self._kind == "fast" else b"x"
        threading.Thread(target=self._write, daemon=True).start()

    def _write(self) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            try:
                os.write(self.writer, self.part)
            except OSError:
                return
            time.sleep(0.0 if self._kind == "fast" else 0.001)
        os.close(self.writer)

    def close(self) -> None:
        assert self._process is not None and self._process.stdout is not None
        self._process.stdout.close()


def answer_of_a_servo(patch: Patch, folder: Path) -> None:
    for kind, open_s in (("fast", PATIENCE_S), ("slow", SHORT_S)):
        patch.setattr(servo_process, "OPEN_S", open_s)
        begun_s = time.monotonic()
        with pytest.raises(HandError, match="the servo of"):
            Servo(kind, {}).open()
        assert time.monotonic() - begun_s < 0.5 * PATIENCE_S


def silent_child(patch: Patch, folder: Path) -> None:
    command = [sys.executable, "-c", "import time; time.sleep(20)"]
    with (folder / "answer").open("w+b") as out, pytest.raises(subprocess.TimeoutExpired):
        limited_child._watched(command, [], out, dict(os.environ), SHORT_S, lambda share: None)


CONTROLLERS = "packages/telenano-devices/telenano_devices/nanonis"
KIT = "telenano/testing/conformance/examination.py"
HAPTIC = "packages/telenano-devices/telenano_devices/impedance"
UDP = "packages/telenano-lab/telenano_lab/networks/udp_ports.py"
LOOPS: dict[str, Callable[[Patch, Path], None]] = {
    f"{CONTROLLERS}/nanonis_client.py: NanonisClient.call": answers_of_a_controller,
    f"{KIT}: _Rig.read_subscriptions": kit_subscriptions,
    f"{KIT}: _connection_events": kit_events,
    f"{KIT}: _stranger": kit_stranger,
    "packages/telenano-lab/telenano_lab/experiments/bus.py: ExperimentBus.wait": answers_of_participants,
    f"{HAPTIC}/vendor_service.py: Conversation.drop": service_of_a_handle,
    f"{UDP}: UdpPorts._take_answers": datagrams_of_the_target,
    f"{UDP}: UdpPorts._take_from_clients": datagrams_of_clients,
    "telenano/console/send_commands.py: _new_subscriptions": console_subscriptions,
    "telenano/console/emergency_stop.py: _Inlet.read_subscription": inlet_subscriptions,
    f"{HAPTIC}/servo_process.py: ProcessLink.open": answer_of_a_servo,
    "services/player/node.py: ReplayPublisher.read_subscriptions": player_subscriptions,
    "telenano/console/live_recording.py: LiveRecording.messages": messages_for_a_recorder,
    "packages/telenano-wide-area/telenano_wide_area/relay/forwarder.py: Forwarder._read": datagrams_at_a_relay,
    "telenano/runtime/security/zap_authenticator.py: ZapAuthenticator._answer": handshakes,
    "telenano/files/limited_child.py: _watched": silent_child,
    "telenano/runtime/wiring/observer.py: Observer.listen": messages_of_a_rig,
    "services/viz_node/hub.py: Hub.tick": messages_for_pages,
}


@pytest.mark.parametrize("take", LOOPS.values(), ids=LOOPS)
def test_a_loop_ends_where_the_other_side_never_does(
    take: Callable[[Patch, Path], None], monkeypatch: Patch, tmp_path: Path
) -> None:
    take(monkeypatch, tmp_path)

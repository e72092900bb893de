"""Driver of Haply's Inverse3 with a VerseGrip, by the JSON over WebSocket of its service, format 3.x on port 10001.

The service sends one full message when a client connects, and then exactly one message of states for each message that
it receives. A state carries neither time nor number, so its age is the time from sending to receipt, and only the
newest message counts as the answer: messages that come before the request, or before another one, were not asked for;
they are dropped and counted, and a service that keeps sending them is lost. A frozen reading shows only as a position
that stands still under a changing force, which the coupling detects.

Frames: the device has +x to the right, +y away from the person and +z up, which is the master frame.
"""

import contextlib
import math
import time
from collections.abc import Callable
from typing import Any

import msgspec

from telenano.extend.hands import Capabilities, DeviceError
from telenano.runtime import StructuredLog
from telenano_devices.haply.haply_device import HaplyConfig
from telenano_devices.haply.haply_messages import BUTTONS, Answer, Arm, ArmConfig
from telenano_devices.impedance.coupling import UPRIGHT, ZERO, Quaternion, Vector
from telenano_devices.impedance.impedance_wire import Turn
from telenano_devices.impedance.servo import DeviceSample
from telenano_devices.impedance.vendor_service import Conversation, Exchange, VendorService
from telenano_devices.impedance.wires import Cadence, Declared, Mechanics, declared

SERVICE = "ws://127.0.0.1:10001"
# Mechanics of the emulated Inverse3.
ARM = Mechanics(mass_kg=0.20, damping_n_s_per_m=0.20)
INSTALL = "start Haply's Inverse Service (Haply Hub, docs.haply.co), or run `telenano device simulate haply`"
INVERSE_SERVICE = VendorService(
    "Inverse Service", "the Haply Inverse3", "haptic_node.haply.service", SERVICE, "format 3.x", INSTALL
)
# The values that Haply's CHAI3D driver declares.
_MAKE = Declared(10.0, 1000.0, 6.0)
# Radii of the workspace, by the type of the device.
_RADII_M = {"inverse3": 0.10, "inverse3x": 0.10, "minverse": 0.04}
EMULATED = "telenano emulator"
# The names of the service's profile while a session runs, and while none runs.
SESSION_RUNS = "org.telenano:session-runs"
SESSION_RESTS = "org.telenano:servo"
# Time limit of the service's answer when it is opened.
_OPEN_S = 3.0
# Time limit of the answer to a request: the silence that the coupling tolerates.
_SILENT_S = 0.05
_CHECK_S = 0.1
# A rendered force that differs from the sent one by more than this share of it plus _FORCE_N is reported.
_FORCE_SHARE = 0.1
_FORCE_N = 0.1


DECODE = msgspec.json.Decoder(Answer).decode
_ENCODER = msgspec.json.Encoder()


class HaplyWire:
    """An `ImpedanceWire` to one Inverse3; a test replaces connect, the clock now_ns [ns] and sleep."""

    def __init__(
        self,
        settings: HaplyConfig,
        *,
        connect: Callable[[str], "Conversation[Answer]"] | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._settings, self._service, self._deadman = settings, settings.service, settings.deadman
        self._connect = connect or (lambda address: Conversation(INVERSE_SERVICE, address, DECODE))
        self._now_ns, self._sleep = now_ns, sleep
        # Presets that end in `centered` put zero at the centre of the workspace.
        self._filters: dict[str, Any] = {"preset": {"preset": settings.preset}}
        if settings.force_gate is not None:
            self._filters["force_gate"] = {"gain": settings.force_gate}
        if settings.damping is not None:
            self._filters["damping"] = {"scalar": settings.damping}
        self._conversation: Conversation[Answer] | None = None
        self._id = ""
        self._head = self._tail = b""
        self._emulated = False
        self._session: bool | None = None
        self._runs = False
        self._differs = 0
        self._exchange: Exchange[Answer] | None = None
        self._orientation, self._grip_ns = UPRIGHT, 0

    def open(self) -> Capabilities:
        self._conversation = self._connect(self._service)
        try:
            arm, has_grip = self._find(self._conversation)
        except DeviceError:
            self.close()
            raise
        self._id = arm.device_id
        before, after = f'{{"{self._settings.force_field}":', "}}}]}"
        self._head = f'{{"inverse3":[{{"device_id":"{self._id}","commands":{{"set_cursor_force":{before}'.encode()
        self._tail = after.encode()
        config = arm.config or ArmConfig()
        self._emulated = config.device_info.model == EMULATED
        self._session, self._differs = None, 0
        self._orientation, self._grip_ns = UPRIGHT, 0
        # A service that comes back after a loss continues with the session of before.
        first = {
            "session": {"configure": {"profile": {"name": SESSION_RUNS if self._runs else SESSION_RESTS}}},
            "inverse3": [{"device_id": self._id, "configure": self._filters, "commands": {"probe_position": {}}}],
        }
        self._conversation.send(_ENCODER.encode(first))
        self._conversation.receive()
        version = f"{config.device_info.major_version}.{config.device_info.minor_version}"
        if self._deadman and not has_grip:
            raise DeviceError(f"{self._service}: haptic_node.haply.deadman is {self._deadman}, and there is no grip")
        return declared(
            f"Haply {config.type} {self._id}, firmware {version}",
            _MAKE._replace(radius_m=_RADII_M.get(config.type, 0.10)),
            self._settings.rate_hz,
            arm=ARM if self._emulated else None,
            buttons=BUTTONS * has_grip,
            deadman=self._deadman,
            has_orientation=has_grip,
        )

    @property
    def unasked(self) -> int:
        """Return the number of messages without a request since the device was opened."""
        return 0 if self._exchange is None else self._exchange.unasked

    def run(self, turn: Turn) -> None:
        """Ask the service at absolute deadlines and pass each sample to `turn`, until it returns None.

        A deadline that a late answer misses is skipped, not made up for.
        """
        if self._conversation is None:
            raise DeviceError(f"{self._service}: the service is not open")
        force: Vector = ZERO
        cadence = Cadence(self._settings.rate_hz, self._now_ns, self._sleep)
        self._exchange = Exchange(self._conversation, f"{self._service}: the service", self._now_ns)
        while True:
            answer, taken_ns = self._exchange.ask(self._message(force), _SILENT_S)
            wanted = turn(self._sample(answer, force, taken_ns))
            if wanted is None:
                return
            force = wanted
            cadence.wait()

    def session(self, runs: bool) -> None:
        self._runs = runs and self._emulated
        self._session = runs if self._emulated else None

    def close(self) -> None:
        """Send zero force and disconnect; the device returns to idle when nothing commands it."""
        if self._conversation is None:
            return
        with contextlib.suppress(DeviceError):
            if self._id:
                self._conversation.send(self._message(ZERO))
        self._conversation.close()
        self._conversation = None

    def _find(self, conversation: Conversation[Answer]) -> tuple[Arm, bool]:
        """Wait for the configured Inverse3, or the only one; return it, and whether there is a grip.

        Raises:
            DeviceError: No such device appears in time, or there are several.
        """
        wanted, answer = self._settings.device_id, conversation.receive(_OPEN_S)
        end_s = self._now_ns() * 1e-9 + _OPEN_S
        while not answer.arms(wanted):
            if self._now_ns() * 1e-9 > end_s:
                what = f"Inverse3 {wanted}" if wanted else "Inverse3"
                there = ", ".join(arm.device_id for arm in answer.inverse3) or "none"
                raise DeviceError(f"{self._service}: the service has no {what} (there is {there}): plug it in")
            self._sleep(0.1)
            conversation.send(b'{"session":{"force_render_full_state":{}}}')
            answer = conversation.receive()
        arms = answer.arms(wanted)
        if len(arms) > 1:
            there = ", ".join(arm.device_id for arm in arms)
            raise DeviceError(f"{self._service}: several devices, {there}: give one as haptic_node.haply.device_id")
        return arms[0], bool(answer.grips)

    def _message(self, force: Vector) -> bytes:
        """Return the request with a force [N], and with the state of the session if that has changed."""
        message = b'%b{"x":%.6f,"y":%.6f,"z":%.6f}%b' % (self._head, *force, self._tail)
        if self._session is not None:
            name = SESSION_RUNS if self._session else SESSION_RESTS
            message = b'{"session":{"configure":{"profile":{"name":"%b"}}},%b' % (name.encode(), message[1:])
            self._session = None
        return message

    def _sample(self, answer: Answer, sent: Vector, taken_ns: int) -> DeviceSample:
        if not (arms := answer.arms(self._id)):
            raise DeviceError(f"{self._service}: the Inverse3 {self._id} is gone: plug it in")
        arm = arms[0]
        if arm.state is None:
            raise DeviceError(f"{self._service}: the Inverse3 {self._id} sends no state")
        error = ""
        if not arm.status.calibrated:
            error = f"the Inverse3 {self._id} is not calibrated: put its handle to the home place"
        elif not arm.status.ready:
            error = f"the Inverse3 {self._id} is not ready: look at its power supply and its light"
        elif arm.state.current_cursor_force is not None:
            self._compare(sent, arm.state.current_cursor_force.vector())
        place = arm.state.cursor_position.vector()
        orientation, buttons = self._gripped(answer, taken_ns)
        held = not self._deadman or bool(buttons >> BUTTONS.index(self._deadman) & 1)
        heard_ns = self._grip_ns if self._deadman else taken_ns
        return DeviceSample(place, taken_ns, orientation, buttons, held, heard_ns, error)

    def _compare(self, sent: Vector, rendered: Vector) -> None:
        """Detect a service that renders another force than the one sent; raise DeviceError if it renders none."""
        if math.dist(sent, rendered) <= _FORCE_N + _FORCE_SHARE * math.hypot(*sent):
            self._differs = 0
            return
        self._differs += 1
        if self._differs != round(_CHECK_S * self._settings.rate_hz):
            return
        if not any(rendered):
            other = "values" if self._settings.force_field == "vector" else "vector"
            text = f"the Inverse3 {self._id} renders no force: give haptic_node.haply.force_field: {other}"
            raise DeviceError(f"{self._service}: {text}")
        text = "the service renders another force than it is sent: its force_gate, damping or force_scale changes it"
        StructuredLog("servo").warning(text, device=self._id, sent_n=math.hypot(*sent), found_n=math.hypot(*rendered))

    def _gripped(self, answer: Answer, now_ns: int) -> tuple[Quaternion, int]:
        """Return orientation and buttons of the grip; a missing or sleeping grip keeps the time of its last report."""
        grip = next(iter(answer.grips), None)
        if grip is None or grip.state is None or not grip.status.awake:
            # A button that is not reported counts as released.
            return self._orientation, 0
        o, self._grip_ns = grip.state.orientation, now_ns
        self._orientation = UPRIGHT if o is None else (o.w, o.x, o.y, o.z)
        return self._orientation, grip.state.pressed

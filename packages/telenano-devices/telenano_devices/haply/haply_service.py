"""An emulated Inverse Service: the JSON of format 3.x over WebSocket, with an Inverse3, a VerseGrip and a hand.

It answers each message with one message of states, as the service does. A force lasts until the next message of the
client, or `FORCE_HOLD_S` without one; for how long the real service holds a force is not documented. The force gate and
the damper are our own models, because the real ones are not published.
"""

import asyncio
import json
import math
from collections.abc import Callable
from typing import Any

from telenano_devices.haply.haply import EMULATED, SESSION_RUNS
from telenano_devices.haply.haply_messages import BUTTONS
from telenano_devices.impedance.coupling import ZERO, Vector
from telenano_devices.impedance.emulated_arm import EmulatedArm, HandMotion
from telenano_devices.impedance.emulated_service import EmulatedService, serve_service

FORCE_HOLD_S = 0.05
PROJECT_VERSION = "3.5.0"
# Period of the grip, which reports at some 50 Hz.
_GRIP_S = 0.02
# The force gate reduces a force that changes its sign more often than this.
_GATE_HZ = 30.0
_GATE_S = 0.1
# Stiffness and damping of an ordinary arm.
_ARM_N_PER_M = 300.0
_ARM_N_S_PER_M = 5.0


class HaplyService:
    """The state of the service and of its devices; the caller passes the time.

    Args:
        arm: The mechanics with the hand.
        device_id: The id of the Inverse3.
        grip: Whether there is a wireless VerseGrip.
    """

    def __init__(self, arm: EmulatedArm, device_id: str = "049D", grip: bool = True) -> None:
        self.arm, self.device_id = arm, device_id
        self.has_grip, self.grip_awake = grip, True
        # A person at the arm also presses the buttons and pulls the cable.
        self.has_person = arm.person is not None
        self.buttons = dict.fromkeys(BUTTONS, False)
        self.plugged = self.calibrated = True
        # Faults: the reported position is frozen, not a number, or offset [m]; the force acts with the wrong sign.
        self.frozen: Vector | None = None
        self.not_a_number = False
        self.offset_m = 0.0
        self.sign = 1.0
        self.late_s = 0.0
        self.gate, self.damping = 0.3, 0.0
        self.accepts = ("vector", "values")
        self.spellings = dict.fromkeys(("vector", "values"), 0)
        self.rendered_n: Vector = ZERO
        self.messages = 0
        self._commanded_s = -math.inf
        self._now_s: float | None = None
        self._heard = (-math.inf, dict(self.buttons))
        self._turns: list[float] = []
        self._sign_before = 0.0

    def connected(self) -> dict[str, Any]:
        """Return the first message to every client."""
        return {"session_id": 0, **self._states(full=True)}

    def answer(self, message: bytes | str, now_s: float) -> dict[str, Any]:
        """Handle a message of a client at a time [s], and return the states that answer it."""
        self.advance(now_s)
        self.messages += 1
        request = json.loads(message)
        session = request.get("session", {})
        name = session.get("configure", {}).get("profile", {}).get("name")
        if name is not None:
            self.arm.start_session(name == SESSION_RUNS)
        force: Vector = ZERO
        for device in request.get("inverse3", ()):
            if device.get("device_id") == self.device_id and self.plugged:
                self._configure(device.get("configure", {}))
                force = self._commanded(device.get("commands", {}))
        self._render(force, now_s)
        return self._states(full="force_render_full_state" in session)

    def advance(self, now_s: float) -> None:
        """Advance to a time [s]; a force that is not repeated ends."""
        before_s, self._now_s = self._now_s, now_s
        if before_s is None:
            return
        if now_s - self._commanded_s > FORCE_HOLD_S or not self.plugged:
            self.rendered_n = ZERO
            self.arm.let_go()
        self.arm.advance(now_s - before_s)
        if self.has_person and (motion := self.arm.motion) is not None:
            self.plugged = motion.plugged
            self.buttons = {name: bool(motion.buttons >> bit & 1) for bit, name in enumerate(self.buttons)}
        if now_s - self._heard[0] >= _GRIP_S:
            self._heard = (now_s, dict(self.buttons))

    def _configure(self, settings: dict[str, Any]) -> None:
        self.gate = float(settings.get("force_gate", {}).get("gain", self.gate))
        self.damping = float(settings.get("damping", {}).get("scalar", self.damping))

    def _commanded(self, commands: dict[str, Any]) -> Vector:
        force_command = commands.get("set_cursor_force", {})
        for spelling in self.accepts:
            if spelling in force_command:
                self.spellings[spelling] += 1
                vector = force_command[spelling]
                return (float(vector["x"]), float(vector["y"]), float(vector["z"]))
        return ZERO

    def _render(self, force: Vector, now_s: float) -> None:
        """Apply the force [N] to the motors, through gate and damper."""
        self._commanded_s = now_s
        v = self.arm.velocity_m_per_s
        kept = self._gate_share(force, now_s)
        x, y, z = (kept * f - self.damping * speed for f, speed in zip(force, v, strict=True))
        self.rendered_n = (x, y, z)
        self.arm.drive((self.sign * x, self.sign * y, self.sign * z))

    def _gate_share(self, force: Vector, now_s: float) -> float:
        """Return the share of a force that the force gate leaves; less if the force changes its sign often."""
        sign = math.copysign(1.0, force[2]) if force[2] else self._sign_before
        if sign != self._sign_before:
            self._turns.append(now_s)
            self._sign_before = sign
        self._turns = [at_s for at_s in self._turns if now_s - at_s < _GATE_S]
        return 1.0 - min(self.gate, 1.0) * (len(self._turns) > _GATE_HZ * _GATE_S)

    def _states(self, full: bool) -> dict[str, Any]:
        states: dict[str, Any] = {"inverse3": [], "wireless_verse_grip": [], "verse_grip": [], "custom_verse_grip": []}
        if self.plugged:
            states["inverse3"].append(self._inverse3(full))
        if self.has_grip:
            state = {
                "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
                "buttons": dict(self._heard[1]),
                "battery_level": 0.8,
            }
            states["wireless_verse_grip"].append(
                {"device_id": "6060", "state": state, "status": {"awake": self.grip_awake, "connected": True}}
            )
        return states

    def _inverse3(self, full: bool) -> dict[str, Any]:
        place = self.arm.measured_m if self.frozen is None else self.frozen
        place = (place[0], place[1], place[2] + self.offset_m)
        speed = ZERO if self.frozen is not None else self.arm.velocity_m_per_s
        domain, mode = ("cartesian", "force") if any(self.rendered_n) else ("undefined", "idle")
        device: dict[str, Any] = {
            "device_id": self.device_id,
            "state": {
                "cursor_position": _xyz(place),
                "cursor_velocity": _xyz(speed),
                "current_cursor_force": _xyz(self.rendered_n),
                "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
                "control_domain": domain,
                "control_mode": mode,
                "mode": mode,
            },
            "status": {
                "calibrated": self.calibrated,
                "in_use": True,
                "power_supply": True,
                "ready": True,
                "started": True,
            },
        }
        if self.not_a_number:
            # JSON cannot express NaN.
            device["state"]["cursor_position"]["z"] = None
        if full:
            device["config"] = {
                "type": "inverse3",
                "port": "emulated",
                "device_info": {"id": 0, "major_version": 3, "minor_version": 5, "model": EMULATED, "uuid": "0" * 32},
                "handedness": "right",
                "gravity_compensation": {"enabled": True, "scaling_factor": 1.0},
                "torque_scaling": {"enabled": True},
                "preset": "arm_front_centered",
                "basis": {"permutation": "XYZ"},
                "filters": {"force_gate": {"gain": self.gate}, "damping": {"scalar": self.damping}},
            }
        return device


def _xyz(vector: Vector) -> dict[str, float]:
    return dict(zip("xyz", vector, strict=True))


ORDERS = (
    "pull | plug | freeze | thaw | nan | number | jump M | sign | late S | drive-late S | sleep | wake | press a|b|c"
    " | release a|b|c | lose-home | home | push N | arm M | loose"
)


def obey(service: HaplyService, line: str) -> str:
    """Apply a typed line to an emulated service, and return a sentence about it or the known orders."""
    word, _, rest = line.strip().partition(" ")
    simple: dict[str, tuple[str, Any, str]] = {
        "pull": ("plugged", False, "the Inverse3 is unplugged"),
        "plug": ("plugged", True, "the Inverse3 is plugged in"),
        "freeze": ("frozen", service.arm.measured_m, "the place on the wire stands still"),
        "thaw": ("frozen", None, "the place on the wire is that of the arm"),
        "nan": ("not_a_number", True, "the place on the wire is not a finite number"),
        "number": ("not_a_number", False, "the place on the wire is a number again"),
        "sign": ("sign", -service.sign, "the motors act the other way round"),
        "sleep": ("grip_awake", False, "the grip is asleep"),
        "wake": ("grip_awake", True, "the grip is awake"),
        "lose-home": ("calibrated", False, "the Inverse3 has lost its calibration"),
        "home": ("calibrated", True, "the Inverse3 is calibrated"),
    }
    if word in simple:
        name, value, text = simple[word]
        setattr(service, name, value)
        return text
    if word == "loose":
        service.arm.person, service.arm.push_n = None, 0.0
        return "no hand holds the handle"
    if word in ("press", "release") and rest in service.buttons:
        service.buttons[rest] = word == "press"
        return f"button {rest} is {'held' if word == 'press' else 'free'}"
    try:
        value = float(rest)
    except ValueError:
        value = math.nan
    if word == "jump" and math.isfinite(value):
        service.offset_m += value
        return f"the place on the wire has jumped by {value:g} m"
    if word in ("late", "drive-late") and 0.0 <= value <= 10.0:
        if word == "late":
            service.late_s = value
            return f"answers come {value:g} s late"
        service.arm.drive_delay_s = value
        return f"forces act {value:g} s late"
    if word == "push" and math.isfinite(value):
        service.arm.person, service.arm.push_n = None, value
        return f"a hand pushes with {value:g} N towards the sample"
    if word == "arm" and math.isfinite(value):
        held = HandMotion((0.0, 0.0, -value), _ARM_N_PER_M, _ARM_N_S_PER_M)
        service.arm.person = lambda time_s: held
        return f"an arm holds the handle, and means to be {value:g} m towards the sample"
    return f"{line.strip()!r} is not known: {ORDERS}"


async def serve_haply(
    service: HaplyService,
    host: str,
    port: int,
    ready: Callable[[int], None],
    lines: "asyncio.Queue[str] | None" = None,
    say: Callable[[str], None] = print,
) -> None:
    """Serve until cancelled, as `serve_service` does; `obey` handles the lines that a person types."""
    version = {"git_tag": "emulated", "git_describe": EMULATED, "project_version": PROJECT_VERSION}
    emulated = EmulatedService(
        "the emulated Inverse Service",
        service.connected,
        service.answer,
        lambda: service.late_s,
        version,
        "format 3.x",
    )
    await serve_service(emulated, (host, port), ready, lines, lambda line: obey(service, line), say)

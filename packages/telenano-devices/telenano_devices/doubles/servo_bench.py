"""A servo with one of three emulated devices in virtual time, with the node's side, the hand, and faults for tests."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from telenano.extend.hands import DeviceError, Gate
from telenano_devices.doubles import libraries
from telenano_devices.force_dimension.dhd import DhdWire
from telenano_devices.force_dimension.dhd_device import DhdConfig
from telenano_devices.haply import haply
from telenano_devices.haply.haply import HaplyWire
from telenano_devices.haply.haply_device import HaplyConfig
from telenano_devices.haply.haply_messages import Answer
from telenano_devices.haply.haply_service import HaplyService
from telenano_devices.impedance.coupling import CouplingSettings
from telenano_devices.impedance.emulated_arm import EmulatedArm, hand_of
from telenano_devices.impedance.impedance_wire import ImpedanceWire
from telenano_devices.impedance.servo import ServoCommand, ServoSample
from telenano_devices.impedance.servo_process import ServoLoop, SharedServo
from telenano_devices.touch.hd import HdWire
from telenano_devices.touch.hd_device import HdConfig

DEVICES = ("haply", "dhd", "hd")
MS = 1_000_000
NOWHERE = (0.0, 0.0, 0.0)
STIFFNESS_N_PER_M = 300.0
# A device with coarser encoders and a lighter arm allows less damping.
DAMPING_N_S_PER_M = {"haply": 8.0, "dhd": 8.0, "hd": 2.0}


class VirtualTime:
    """The clock of a bench."""

    def __init__(self) -> None:
        self.ns = 10**9
        self.passes: Callable[[float], None] = lambda duration_s: None
        self.watch: Callable[[], None] = lambda: None
        # Returns the virtual time [ns] of the library, which is ahead after a call that returns late.
        self.taken_ns: Callable[[], int] = lambda: 0

    def now_ns(self) -> int:
        self.ns = max(self.ns, self.taken_ns())
        return self.ns

    def sleep(self, duration_s: float) -> None:
        self.ns += round(duration_s * 1e9)
        self.passes(duration_s)
        self.watch()

    @property
    def s(self) -> float:
        return self.ns * 1e-9


class MemoryConversation:
    """A conversation with an emulated service without a socket; an answer takes 0.2 ms plus the service's delay."""

    def __init__(self, service: HaplyService, time: VirtualTime) -> None:
        self.service, self.time = service, time
        self._answers = [json.dumps(service.connected())]

    def send(self, message: bytes) -> None:
        if getattr(self.service, "killed", False):
            raise DeviceError("ws://emulated: the service has closed the connection")
        self.time.sleep(2e-4)
        self._answers.append(json.dumps(self.service.answer(message, self.time.s)))
        self.time.sleep(self.service.late_s)

    def wait(self, patience_s: float = 0.0) -> None:
        """Do nothing, because each answer is there immediately."""

    def drop(self, keep: int = 0) -> int:
        dropped = max(0, len(self._answers) - keep)
        del self._answers[:dropped]
        return dropped

    def receive(self, patience_s: float = 0.0) -> Answer:
        return haply.DECODE(self._answers.pop(0))

    def close(self) -> None:
        """Do nothing, because there is no socket."""


class EmulatedDevice:
    """One device with its wire. `do` puts in a fault, by names common to all three devices."""

    def __init__(self, kind: str, time: VirtualTime, folder: Path, **settings: Any) -> None:
        self.kind, self.time = kind, time
        clock: dict[str, Any] = {"now_ns": time.now_ns, "sleep": time.sleep}
        self.wire: ImpedanceWire
        if kind == "haply":
            self.service = HaplyService(EmulatedArm(hand_of(), haply.ARM))

            def connect(address: str) -> Any:
                if getattr(self.service, "killed", False):
                    raise DeviceError(f"no Inverse Service answers at {address}: {haply.INSTALL}")
                return MemoryConversation(self.service, time)

            self.wire = HaplyWire(HaplyConfig(**settings), connect=connect, **clock)
            return
        path = folder / f"{kind}.so"
        shutil.copy(libraries.build(kind), path)
        self.double = libraries.Double(path)
        self.double.set("virtual_s", time.s)
        time.passes, time.taken_ns = self._pass, lambda: round(self.double.get("virtual_s") * 1e9)
        settings["library"] = str(path)
        self.wire = DhdWire(DhdConfig(**settings), **clock) if kind == "dhd" else HdWire(HdConfig(**settings), **clock)

    def _pass(self, duration_s: float) -> None:
        """Advance the device by a wait [s]; the scheduler of HD calls back in each millisecond of it."""
        if self.kind == "dhd" or duration_s <= 1e-3:
            self.double.set("virtual_s", self.time.s)
            return
        end_ns = self.time.ns
        self.time.ns -= round(duration_s * 1e9)
        while self.time.ns < end_ns:
            self.time.ns += MS
            self.double.set("virtual_s", self.time.s)
            self.double.tick()
            self.time.watch()

    @property
    def force_n(self) -> float:
        """Magnitude of the force of the motors [N]."""
        if self.kind == "haply":
            self.service.advance(self.time.s)
            return math.hypot(*self.service.arm.force_n)
        return self.double.get("force_size")

    @property
    def height_m(self) -> float:
        """True position of the arm, positive away from the sample [m]."""
        return self.service.arm.position_m[2] if self.kind == "haply" else self.double.get("place")

    def hand(self, push_n: float = 0.0, held: bool = False) -> None:
        """Push with a force towards the sample [N], or hold the arm where it is."""
        if self.kind == "haply":
            self.service.arm.push_n, self.service.arm.held = push_n, held
        else:
            self.double.set("push_n", push_n)
            self.double.set("held", float(held))

    def centre(self) -> None:
        """Put the arm back to the centre of its workspace."""
        if self.kind == "haply":
            self.service.arm.position_m = NOWHERE
        else:
            self.double.set("place", 0.0)

    def do(self, what: str, value: Any = True) -> None:
        if self.kind != "haply":
            names = {"calibrated": ("uncalibrated", not value), "plugged": ("unplugged", not value)}
            name, number = names.get(what, (what, value))
            self.double.set(name, float(number))
        elif what == "drive_delay_s":
            self.service.arm.drive_delay_s = value
        elif what == "frozen":
            self.service.frozen = self.service.arm.measured_m if value else None
        else:
            setattr(self.service, {"latency_s": "late_s"}.get(what, what), value)


class ServoBench:
    """Acts as the node at the shared memory of a servo: it engages a device that is ready.

    Args:
        kind: haply, dhd or hd.
        folder: The folder for a copy of the double's library, so that each test has its own.
        settings: The settings of the wire.
    """

    def __init__(self, kind: str, folder: Path, **settings: Any) -> None:
        self.time = VirtualTime()
        self.device = EmulatedDevice(kind, self.time, folder, **settings)
        self.found = self.device.wire.open()
        self.shared = SharedServo(bytearray(SharedServo.SIZE))
        self.coupling = CouplingSettings(
            stiffness_n_per_m=(0.0, 0.0, STIFFNESS_N_PER_M),
            damping_n_s_per_m=(0.5, 0.5, DAMPING_N_S_PER_M[kind]),
            max_force_n=min(3.0, self.found.max_force_n),
            max_slew_n_per_s=1000.0,
            velocity_filter_hz=200.0,
            needs_deadman=bool(self.found.deadman),
            runaway_m_per_s=0.3,
        )
        self.reference_m = 0.0
        # Speed of the reference along z [m/s].
        self.moves_m_per_s = 0.0
        self.arm_count = 0
        self.silent = self.gone = False
        self.forces: list[tuple[float, float]] = []
        self.samples: list[ServoSample] = []
        self.errors: list[str] = []
        self._count = 0
        self._at: list[tuple[float, Callable[[], None]]] = []
        self._began_s = self.time.s
        self._end_s = 0.0
        self._wrote_ns = 0

    @property
    def s(self) -> float:
        return self.time.s - self._began_s

    @property
    def newest(self) -> ServoSample:
        return self.samples[-1]

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        self._at.append((time_s, action))
        self._at.sort(key=lambda entry: entry[0])

    def run(self, duration_s: float) -> None:
        """Run the loop of the servo's process, from beginning to end, for duration_s [s] of virtual time."""
        self._end_s = self.s + duration_s
        self.time.watch = lambda: self.forces.append((self.s, self.device.force_n))
        loop = ServoLoop(
            self.shared,
            self.device.wire,
            self.found,
            now_ns=self.time.now_ns,
            sleep=self.time.sleep,
            is_needed=self._is_needed,
        )
        loop.run()

    def _is_needed(self) -> bool:
        """Act as the node each millisecond, whenever the servo asks whether it is still needed; return that."""
        sample = self.shared.sample()
        if sample is not None:
            self.samples.append(sample)
            if sample.error and (not self.errors or self.errors[-1] != sample.error):
                self.errors.append(sample.error)
        while self._at and self.s >= self._at[0][0]:
            self._at.pop(0)[1]()
        self.time.watch()
        passed_s = (self.time.ns - self._wrote_ns) * 1e-9 if self._wrote_ns else 0.0
        if not self.silent and (passed_s >= 1e-3 or not self._wrote_ns):
            self._wrote_ns = self.time.ns
            self._command(sample, passed_s)
        return self.s < self._end_s and not self.gone

    def _command(self, sample: ServoSample | None, passed_s: float) -> None:
        engaged = sample is not None and sample.gate in (Gate.READY, Gate.ACTIVE) and not sample.error
        if sample is None or sample.gate != Gate.ACTIVE:
            self.reference_m = 0.0 if sample is None else sample.position_m[2]
        else:
            self.reference_m += self.moves_m_per_s * passed_s
        self._count += 1
        self.shared.write_command(
            ServoCommand(
                counter=self._count,
                sent_ns=self.time.ns,
                position_m=(0.0, 0.0, self.reference_m),
                velocity_m_per_s=NOWHERE,
                force_n=NOWHERE,
                engaged=engaged,
                arm_count=self.arm_count,
                stop=False,
                settings=self.coupling,
            )
        )

    def greatest_n(self, from_s: float, to_s: float) -> float:
        """Return the greatest force of the motors between two times [N]."""
        return max(force for at_s, force in self.forces if from_s <= at_s <= to_s)

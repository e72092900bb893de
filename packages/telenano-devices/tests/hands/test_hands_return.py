"""A hand's device that returns: drawn losses, stops, motions and words, judged by the emulated motor and arm.

The truth is what the emulated motor does, where the arm is, and what a person has done; neither driver nor messages are
asked. After a stop the motor stands until a person arms, however device, line and process come and go. Otherwise the
motor begins where the arm is, and goes on at the speed of the guard, below the limits of force and slew.
"""

import random
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from string import Template
from types import MappingProxyType, ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest

if shutil.which("cc") is None:
    pytest.skip("the emulated devices need a C compiler: apt install gcc libc6-dev", allow_module_level=True)

from telenano_devices.doubles.servo_bench import EmulatedDevice, VirtualTime
from telenano_devices.handle.handle_line import HandleLine
from telenano_devices.impedance import servo_process
from telenano_devices.impedance.impedance_config import CouplingConfig
from telenano_devices.impedance.impedance_device import ImpedanceDevice
from telenano_devices.impedance.servo import ServoCommand, ServoSample
from telenano_devices.impedance.servo_process import ServoLoop, SharedServo

from telenano.extend.hands import MODE_OFF
from telenano.testing import haptic_config, haptic_device_of, haptic_node
from telenano.wire import RefusedError

MS = 1_000_000
CONSOLE, LAW = "console@master", "controller@master"
LIMITS = haptic_config().limits
SPEED_M_PER_S = LIMITS.max_speed_m_per_s
# A device lets its arm go a fifth faster than the guard, for the jitter of two clocks; a servo of its own overshoots.
STEP_M = 1.25e-3 * SPEED_M_PER_S
# Time after which the motor of a device that hears nothing is off by its own watchdog or by its service [ms].
LETS_GO_MS = 60
# Time after which the motor is off after a stop: the period of the node, that of the device, and a byte's way [ms].
STOPS_MS = 3
# Longest time in which a device that may be driven is driven again, with its handshake and the rest of the hand [ms].
BACK_MS = 900
# Way by which a hand carries the arm in a millisecond [m].
CARRIED_M = 1e-4
# Time within which a device that is back has told that it was stopped [ms].
TELLS_MS = 400
# Time without force after which a motor is off [ms].
OFF_MS = 3
# Time for which a hand still holds the arm after the motor has begun [ms].
HELD_MS = 30
# Looking for a lost device happens more often than the driver's half second, so that the walks are short [s].
RETRY_S = 0.1


class Hand:
    """A node with an emulated device, one millisecond a `tick`, and the ways to lose the device.

    losses: begin and end of each loss, by name. deaf: losses in which the device does not hear the node.
    """

    losses: Any = MappingProxyType({})
    deaf: tuple[str, ...] = ()
    lets_go_ms = LETS_GO_MS
    # Whether the present millisecond is over for the device as well.
    is_present = True
    has_switch = False

    def __init__(self, bench: Any) -> None:
        self.bench: Any = bench
        self.node: Any = None
        self.x_m, self.speaks = 0.0, True

    def begin(self, driver: Any, section: Any = None) -> None:
        """Start a process of the node, which finds the stop that was kept for it before anything else."""
        kept = self.node is not None and self.node.is_latched
        self.node = haptic_node(self.bench, driver, section)
        if kept:
            self.control("estop")

    def control(self, command: str) -> None:
        fields = {"id": "a", "command": command, "target": "haptic_node", "parameters": {}}
        self.node.on_control(self.bench.make("session/control", CONSOLE, **fields))

    def turn(self) -> None:
        """Let the law command the place `x_m`, unless it is silent, and the node take its turn."""
        bench = self.bench
        if self.speaks:
            fields: dict[str, Any] = {
                "mode": "position",
                "position_m": (0.0, 0.0, -self.x_m),
                "velocity_m_per_s": (0.0, 0.0, 0.0),
            }
            fields |= {"force_n": (0.0, 0.0, 0.0), "hand_seq": 0, "hand_t_ns": bench.clock.now_ns()}
            self.node.on_message(bench.received("haptic/command", LAW, **fields))
        bench.clock.advance_ns(max(0, self.node.deadline_ns() - bench.clock.monotonic_ns()))
        self.node.on_deadline(bench.clock.monotonic_ns())
        bench.sent.clear()

    def run(self, script: Iterator[None]) -> None:
        """Let a millisecond pass at each step of a script."""
        for _ in script:
            self.pass_ms()
            self.turn()

    def pass_ms(self) -> None:
        """Let a millisecond pass for the device."""

    def begin_again(self) -> None:
        """Let the process of the node end without a word, and start another one on the same device."""
        raise NotImplementedError

    def drives(self) -> bool:
        """Return whether the motor is driven."""
        raise NotImplementedError

    def place_m(self) -> float:
        """Return where the arm is, towards the sample [m]."""
        raise NotImplementedError

    def move(self, place_m: float) -> None:
        """Let a hand put the arm to a place while nothing drives it [m]."""

    def press(self, pressed: bool) -> None:
        """Press the emergency stop of the device itself, or let it go."""

    def fault(self, since_ms: int, moved_m: float, stands: bool) -> str:
        """Return what is wrong with the motion or the force; empty if nothing is.

        Args:
            since_ms: The time since the motor began [ms].
            moved_m: The way of the arm in this millisecond [m].
            stands: Whether the hand holds the arm, and held it still before the motor began.
        """
        return "" if abs(moved_m) <= STEP_M else f"moved {1e3 * moved_m:.3f} mm in a millisecond"


class Serial(Hand):
    """The handle: the firmware's own core with the compiled motor, behind a port."""

    deaf = ("cable", "full", "taken")
    has_switch = True

    def __init__(self, bench: Any, tmp_path: Path) -> None:
        super().__init__(bench)
        self.line = HandleLine()
        self.boots = 1
        self.losses = {
            "cable": (self._set("plugged", False), self._mend),
            "silent": (lambda: setattr(self.line, "to_host", lambda sent: b""), self._mend),
            "full": (self._set("reading", False), self._mend),
            "taken": (self._take_port, self._mend),
            "late": (self._set("latency_ms", 70.0), self._mend),
            "reset": (self._reset, self._mend),
        }
        self.begin(self.line.driver)

    def _set(self, name: str, value: Any) -> Callable[[], None]:
        return lambda: setattr(self.line, name, value)

    def _take_port(self) -> None:
        self.line.plugged, self.line.holder = False, "ModemManager (812)"

    def _reset(self) -> None:
        self.boots += 1
        self.line.handle.reset(self.boots)

    def _mend(self) -> None:
        line = self.line
        line.plugged = line.reading = True
        line.holder, line.latency_ms, line.to_host = "", 0.0, lambda sent: sent

    def pass_ms(self) -> None:
        self.line.pass_ms(1)

    def begin_again(self) -> None:
        old = self.line
        self.line = HandleLine()
        self.line.handle, self.line.now_ns = old.handle, old.now_ns
        self.begin(self.line.driver)

    def drives(self) -> bool:
        return bool(self.line.handle.core.mode != MODE_OFF or self.line.handle.drive_v)

    def place_m(self) -> float:
        return float(self.line.handle.position_m)

    def move(self, place_m: float) -> None:
        self.line.handle.place(place_m)

    def press(self, pressed: bool) -> None:
        self.line.handle.estop_pressed = pressed


class Simulated(Hand):
    """The simulated device, whose line is that to the law only."""

    section: ClassVar[dict[str, Any]] = {"operator": {"kind": "force_profile"}}

    def __init__(self, bench: Any, tmp_path: Path) -> None:
        super().__init__(bench)
        self.device = haptic_device_of(self.section)
        self.begin(self.device, self.section)

    def begin_again(self) -> None:
        # The simulated arm is part of the process, so that the new one has an arm of its own.
        self.device = haptic_device_of(self.section)
        self.begin(self.device, self.section)

    def drives(self) -> bool:
        return bool(self.device.state.command.mode != MODE_OFF)

    def place_m(self) -> float:
        return float(self.device.state.plant.motor.position_m)


class SimulatedCoupled(Simulated):
    """The simulated device that takes a force."""

    section: ClassVar[dict[str, Any]] = {
        "driver": "simulated_impedance", "coupling": {"rest_s": 0.05}, "operator": {"kind": "force_profile"},
    }  # fmt: skip

    def drives(self) -> bool:
        return any(self.device.state.plant.coupling.force_n)

    def place_m(self) -> float:
        return float(-self.device.state.plant.position_m[2])

    def fault(self, since_ms: int, moved_m: float, stands: bool) -> str:
        force_n = abs(self.device.state.plant.coupling.force_n[2])
        return too_much(force_n, since_ms, self.device._params.settings, held=False)


def too_much(force_n: float, since_ms: int, settings: Any, held: bool) -> str:
    """Return what is wrong with the force on a hand; one that holds the arm still feels the reference leave it."""
    k, b = settings.stiffness_n_per_m[2], settings.damping_n_s_per_m[2]
    s = 1e-3 * (since_ms + 2)
    most_n = min(settings.max_force_n, settings.max_slew_n_per_s * s)
    if held:
        most_n = min(most_n, k * SPEED_M_PER_S * (s + 2e-3) + b * SPEED_M_PER_S + 0.02)
    return "" if force_n <= most_n * (1.0 + 1e-9) else f"{force_n:.3f} N, {since_ms} ms after it began"


class MemoryLink:
    """The node's side of the shared memory of a servo that runs in virtual time; `ended`: its process has ended."""

    def __init__(self, shared: SharedServo, found: Any) -> None:
        self.shared, self.capabilities = shared, found
        self.ended = False

    def open(self) -> None:
        """Do nothing, because the servo runs."""

    def send(self, command: ServoCommand) -> None:
        self.shared.write_command(command)

    def newest(self, session_time_s: float, dt_s: float) -> ServoSample | None:
        self.shared.flag(session_time_s >= 0.0, False)
        sample = self.shared.sample()
        return (sample or ServoSample())._replace(error="the servo has ended") if self.ended else sample

    def close(self) -> None:
        """Do nothing: `Servoed` ends the servo."""


class Servoed(Hand):
    """A device that takes a force: the loop of its servo, the wire of its driver, and the emulated maker's side."""

    kind = ""
    # Time for which the process of a servo is away [ms].
    AWAY_MS = 30

    def __init__(self, bench: Any, tmp_path: Path) -> None:
        super().__init__(bench)
        self.time = VirtualTime()
        self.emulated: Any = EmulatedDevice(self.kind, self.time, tmp_path)
        self.found = self.emulated.wire.open()
        self.coupling = CouplingConfig(rest_s=0.05)
        self.settings = self.coupling.to_settings(self.found)
        self.turned_ns, self.away_ms = self.time.ns, 0
        self.loop_ends = self.is_held = False
        self.losses = {
            "cable": (self._do("plugged", False), self._do("plugged", True)),
            "calibration": (self._do("calibrated", False), self._do("calibrated", True)),
            "late": (self._do("latency_s", 0.1), self._do("latency_s", 0.0)),
            "servo": (self._end_servo, lambda: None),
            "jump": (self._do("offset_m", 0.010), self._do("offset_m", 0.0)),
        }
        if self.kind == "haply":
            self.losses["service"] = (self._do("killed", True), self._do("killed", False))
        if self.kind == "hd":
            self.losses["scheduler"] = (self._do("stopped", True), self._do("stopped", False))
        self._connect()

    def _do(self, what: str, value: Any) -> Callable[[], None]:
        return lambda: self.emulated.do(what, value)

    def _end_servo(self) -> None:
        self.loop_ends, self.link.ended, self.away_ms = True, True, self.AWAY_MS

    def _connect(self) -> None:
        self.shared = SharedServo(bytearray(SharedServo.SIZE))
        self.link = MemoryLink(self.shared, self.found)
        self.begin(ImpedanceDevice(self.link, self.coupling, 1e-3, self.time.now_ns))

    def begin_again(self) -> None:
        self._end_servo()
        self._connect()

    def run(self, script: Iterator[None]) -> None:
        done = False

        def watch() -> None:
            nonlocal done
            while not done and self.time.ns - self.turned_ns >= MS:
                self.turned_ns += MS
                self.is_present = self.time.ns - self.turned_ns < MS
                done = next(script, self) is self
                if not done:
                    self.turn()

        def is_needed() -> bool:
            watch()
            return not (done or self.loop_ends)

        self.time.watch = watch
        while not done:
            self.loop_ends = False
            clock: dict[str, Any] = {"now_ns": self.time.now_ns, "sleep": self.time.sleep}
            ServoLoop(self.shared, self.emulated.wire, self.found, **clock, is_needed=is_needed).run()
            while self.away_ms and not done:
                self.away_ms -= 1
                self.time.sleep(1e-3)
            self.link.ended = False
            while not done:
                try:
                    self.emulated.wire.open()
                    break
                except RuntimeError:
                    self.link.ended = True
                    self.time.sleep(RETRY_S)
            self.link.ended = False

    def drives(self) -> bool:
        return bool(self.emulated.force_n > 0.0)

    def place_m(self) -> float:
        return float(-self.emulated.height_m)

    def hold(self, held: bool) -> None:
        self.is_held = held
        self.emulated.hand(0.0 if held else 0.5, held)

    def move(self, place_m: float) -> None:
        if self.kind == "haply":
            self.emulated.service.arm.position_m = (0.0, 0.0, -place_m)
        else:
            self.emulated.double.set("place", -place_m)

    def fault(self, since_ms: int, moved_m: float, stands: bool) -> str:
        return too_much(self.emulated.force_n, since_ms, self.settings, stands)


class Haply(Servoed):
    kind = "haply"


class Dhd(Servoed):
    kind = "dhd"


class Hd(Servoed):
    kind = "hd"
    # While a call of the maker's library does not return, for 100 ms at most here, nobody can take the force.
    lets_go_ms = 105


class ThreadTime:
    """The time of a driver's thread, which a test lets pass, and then waits until the thread waits again."""

    def __init__(self) -> None:
        self.s = 1.0
        self._changes = threading.Condition()
        self._until_s: float | None = None
        self._thread: threading.Thread | None = None

    def monotonic(self) -> float:
        return self.s

    def wait(self, duration_s: float, ended: Callable[[], bool] = lambda: False) -> None:
        with self._changes:
            until_s = self.s + duration_s
            while self.s < until_s - 1e-9 and not ended():
                self._until_s = until_s
                self._thread = threading.current_thread()
                self._changes.notify_all()
                self._changes.wait()
            self._until_s = None

    def pass_s(self, duration_s: float) -> None:
        with self._changes:
            self.s += duration_s
            self._changes.notify_all()
            while self._thread is not None and self._thread.is_alive():
                if self._until_s is not None and self._until_s > self.s + 1e-9:
                    return
                self._changes.wait(0.01)

    def event(self) -> Any:
        flag = threading.Event()

        def end() -> None:
            with self._changes:
                flag.set()
                self._changes.notify_all()

        return SimpleNamespace(
            set=end, clear=flag.clear, is_set=flag.is_set, wait=lambda time_s: self.wait(time_s, flag.is_set)
        )


class Own(Hand):
    """The driver that `telenano new device` makes, with hardware whose motor has a watchdog of 50 ms of its own."""

    has_switch = True

    def __init__(self, bench: Any, tmp_path: Path) -> None:
        super().__init__(bench)
        self.clock, clock = ThreadTime(), self
        module = ModuleType("telenano_returns")
        sys.modules[module.__name__] = module
        text = Template((files("telenano") / "templates" / "device.py.txt").read_text(encoding="utf-8"))
        exec(text.substitute(name="returns", constant="RETURNS"), module.__dict__)
        passing = self.clock
        module.time = SimpleNamespace(monotonic=passing.monotonic)  # type: ignore[attr-defined]
        module.threading = SimpleNamespace(  # type: ignore[attr-defined]
            Lock=threading.Lock, Thread=threading.Thread, Event=passing.event
        )
        module.RETRY_S = RETRY_S  # type: ignore[attr-defined]

        class Motor(module.Hardware):  # type: ignore[name-defined, misc]
            out, hangs_s, mode, reference_m, heard_s = False, 0.0, MODE_OFF, 0.0, 0.0
            pressed = stopped = killed = False

            def connect(self) -> None:
                if self.out:
                    raise OSError("nothing answers")

            def exchange(self, command: Any) -> Any:
                self.connect()
                self.heard_s = passing.s
                self.mode = MODE_OFF if self.stopped else command.mode
                self.reference_m = command.position_reference_m
                sample = super().exchange(command._replace(mode=self.mode))
                if self.hangs_s:
                    passing.wait(self.hangs_s, lambda: self.killed)
                # A stop is told once it is over, too, as the firmware of the handle does.
                told, self.stopped = self.stopped or self.pressed, self.pressed
                return sample._replace(estop_pressed=told)

            def switch_off(self) -> None:
                self.mode = MODE_OFF

        self.module, self.motor = module, Motor(module.Config())
        clock.losses = {
            "cable": (self._set("out", True), self._set("out", False)),
            "hangs": (self._set("hangs_s", 0.2), self._set("hangs_s", 0.0)),
        }
        self.deaf = ("cable",)
        self.device = module.Handle(module.Config(), LIMITS, self.motor)
        self.begin(self.device)

    def _set(self, name: str, value: Any) -> Callable[[], None]:
        return lambda: setattr(self.motor, name, value)

    def pass_ms(self) -> None:
        self.clock.pass_s(1e-3)
        if self.clock.s - self.motor.heard_s > 0.05:
            self.motor.mode = MODE_OFF

    def begin_again(self) -> None:
        self.end()
        self.device = self.module.Handle(self.module.Config(), LIMITS, self.motor)
        self.begin(self.device)

    def end(self) -> None:
        self.motor.killed = True
        self.device._ended.set()
        self.device._thread.join(1.0)
        self.motor.killed = False

    def drives(self) -> bool:
        return bool(self.motor.mode != MODE_OFF)

    def place_m(self) -> float:
        return float(self.motor._position_m)

    def move(self, place_m: float) -> None:
        self.motor._position_m = place_m

    def press(self, pressed: bool) -> None:
        self.motor.pressed = pressed
        self.motor.stopped |= pressed


HANDS: dict[str, type[Any]] = {
    "serial": Serial, "haply": Haply, "dhd": Dhd, "hd": Hd, "own": Own,
    "simulated": Simulated, "simulated_impedance": SimulatedCoupled,
}  # fmt: skip
STATES = ("stopped", "unarmed", "in contact", "profile")


class Walk:
    """A drawn walk of one hand, and the judge of its motor.

    stopped: a person, or the switch of the device, has stopped the motor, and nobody has armed since. refused: the
    encoder has jumped, and nobody has armed since. rounds, stays_off: returns that had to be driven, and those that
    were not.
    """

    def __init__(self, hand: Hand, rng: random.Random) -> None:
        self.hand, self.rng = hand, rng
        self.stopped = self.refused = self.may_refuse = self.kept = False
        self.since_stop_ms = self.since_loss_ms = self.since_end_ms = self.on_ms = 0
        self.off_ms, self.stood_ms = OFF_MS, 0
        self.loss, self.is_lost = "", False
        self.was_m, self.may_move = hand.place_m(), False
        self.done, self.faults = list[str](), list[str]()
        self.rounds = self.stays_off = 0
        # Where the hand carries the arm [m]; None while it does not.
        self.to_m: float | None = None

    def stop(self, what: str) -> None:
        self.done.append(what)
        self.since_stop_ms = self.since_stop_ms if self.stopped else 0
        self.stopped = True
        if what == "estop":
            self.hand.control("estop")
        else:
            self.hand.press(True)
            self.kept |= self.is_lost

    def arm(self) -> None:
        try:
            self.hand.control("arm")
            self.stopped = self.refused = False
            # A stop that the device has kept may be told after the word, and is then obeyed.
            self.kept &= self.is_lost or self.since_end_ms < TELLS_MS
            self.may_refuse = self.kept
            self.done.append("armed")
        except RefusedError:
            self.done.append("not armed")

    def judge(self) -> None:
        hand = self.hand
        self.since_stop_ms += self.stopped
        self.since_loss_ms = self.since_loss_ms + 1 if self.is_lost else 0
        self.since_end_ms = 0 if self.is_lost else self.since_end_ms + 1
        drives, place_m = hand.drives(), hand.place_m()
        moved_m, self.was_m = 0.0 if self.may_move else place_m - self.was_m, place_m
        self.stood_ms = 0 if self.may_move or self.on_ms > HELD_MS else self.stood_ms + 1
        self.may_move = False
        # A force may pass zero for a moment.
        self.off_ms = 0 if drives else self.off_ms + 1
        self.on_ms = self.on_ms + 1 if self.off_ms < OFF_MS else 0
        if not hand.is_present:
            # A call has taken longer than a millisecond: the force is judged at its end.
            self.stood_ms = 0
            return
        if drives and (self.stopped or self.refused):
            # A stop that cannot reach the device is carried out by its watchdog.
            most_ms = STOPS_MS if self.since_end_ms > hand.lets_go_ms else hand.lets_go_ms
            if self.since_stop_ms > most_ms:
                self.faults.append(f"driven {self.since_stop_ms} ms after a stop")
        if drives and self.loss in hand.deaf and self.since_loss_ms > hand.lets_go_ms:
            self.faults.append(f"driven {self.since_loss_ms} ms after the loss")
        if found := hand.fault(self.on_ms, moved_m, self.on_ms <= HELD_MS and self.stood_ms > HELD_MS):
            self.faults.append(found)

    def ticks(self, count: int) -> Iterator[None]:
        for _ in range(count):
            self._carry()
            yield
            self.judge()
            # The hand holds the arm while the motor is off; one that stood still under a changing force for longer
            # would be a frozen reading.
            self._hold(self.on_ms <= HELD_MS)
            if self.rng.random() < 0.01:
                self.hand.x_m = self.rng.uniform(-0.004, 0.012)

    def _carry(self) -> None:
        """Let the hand carry the arm on, while nothing drives it."""
        if self.hand.drives():
            self.to_m = None
        if self.to_m is not None:
            left_m = self.to_m - self.hand.place_m()
            self.may_move = True
            self.hand.move(self.hand.place_m() + min(max(left_m, -CARRIED_M), CARRIED_M))

    def _hold(self, held: bool) -> None:
        if isinstance(self.hand, Servoed):
            self.hand.hold(held)

    def _lose(self) -> Iterator[None]:
        """Lose the device for a drawn time, in which the hand moves and a person acts, and let it return."""
        hand, rng = self.hand, self.rng
        self.loss = rng.choice((*hand.losses, "process", "law"))
        self.done.append(self.loss)
        lasts_ms = rng.choice((5, 30, 90, 400))
        begin, end = hand.losses.get(self.loss, (lambda: None, lambda: None))
        if self.loss == "law":
            hand.speaks = False
        self._jumps()
        begin()
        if self.loss == "process":
            hand.begin_again()
            # The opening of a port takes some milliseconds of one turn, and a simulated arm is a new one.
            self.may_move = isinstance(hand, Simulated | Serial)
            # The refusal of a reading is that of the process that saw it.
            self.refused = False
        self.is_lost = True
        acts = {rng.randrange(lasts_ms): rng.choice(("estop", "switch", "arm", "move", "")) for _ in range(2)}
        for ms in range(lasts_ms):
            what = acts.get(ms, "")
            if what == "arm":
                self.arm()
            elif what == "estop" or (what == "switch" and hand.has_switch):
                self.stop(what)
            elif what == "move":
                self.to_m = min(max(hand.place_m() + rng.uniform(-0.003, 0.003), -0.004), 0.012)
            yield from self.ticks(1)
            hand.press(False)
        self.done.append(f"{lasts_ms} ms")
        self.is_lost, hand.speaks = False, True
        self._jumps()
        end()

    def _jumps(self) -> None:
        """Note that the encoder jumps; a jump that nobody saw, because the servo was away, is refused by nobody."""
        if self.loss == "jump":
            self.may_refuse = True
            if self.hand.drives():
                self.refused, self.since_stop_ms = True, 0

    def script(self) -> Iterator[None]:
        rng = self.rng
        for _ in range(2):
            state = rng.choice(STATES)
            self.done.append(state)
            if state == "stopped":
                self.stop("estop")
            elif state != "unarmed":
                yield from self.ticks(2)
                self.arm()
            if state == "profile":
                self.hand.control("start")
            yield from self.ticks(rng.choice((30, 200, 400)))
            yield from self._lose()
            if rng.random() < 0.5:
                yield from self.ticks(rng.choice((5, 60)))
                yield from self._lose()
            yield from self._returns()

    def _returns(self) -> Iterator[None]:
        """Wait until the device is driven again, which must not be if it was stopped, and must be otherwise."""
        waits = not (self.stopped or self.may_refuse)
        driven_ms = 0
        for _ in range(BACK_MS):
            driven_ms += self.hand.drives()
            if waits and driven_ms > HELD_MS:
                break
            self.hand.x_m = self.hand.place_m() + 1e-3
            yield from self.ticks(1)
        self.rounds += waits
        self.stays_off += waits and not driven_ms


def walked(bench_of: Any, kind: str, seed: int, folder: Path) -> Walk:
    # A library that is loaded must not be written over.
    (own := folder / str(seed)).mkdir()
    hand = HANDS[kind](bench_of("haptic_node@master"), own)
    walk = Walk(hand, random.Random(f"{kind} {seed}"))
    hand.run(walk.script())
    hand.node.make_safe()
    return walk


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("telenano.devices.hand.serial_driver.RETRY_NS", round(RETRY_S * 1e9))
    monkeypatch.setattr(servo_process, "RETRY_S", RETRY_S)


def broken(bench_of: Any, kind: str, seeds: range, folder: Path) -> tuple[list[Any], int, int]:
    """Return the walks in which the motor did what it must not, the returns that had to be driven, and those not."""
    walks = [(seed, walked(bench_of, kind, seed, folder)) for seed in seeds]
    found = [(seed, walk.done, walk.faults[:2], len(walk.faults)) for seed, walk in walks if walk.faults]
    return found, sum(walk.rounds for _, walk in walks), sum(walk.stays_off for _, walk in walks)


@pytest.mark.check("takes some seconds")
@pytest.mark.drawn(1.0)
@pytest.mark.parametrize("kind", HANDS)
def test_no_order_of_losses_returns_and_words_drives_a_stopped_hand_or_throws_one(
    bench_of: Any, kind: str, tmp_path: Path
) -> None:
    found, returns, stays_off = broken(bench_of, kind, range(4), tmp_path)
    assert found == []
    # A motor that never drives again would pass, so that the returns are counted.
    assert returns and not stays_off


@pytest.mark.endurance
@pytest.mark.parametrize("part", range(10))
@pytest.mark.parametrize("kind", HANDS)
def test_two_thousand_orders_drive_no_stopped_hand_and_throw_none(
    bench_of: Any, kind: str, part: int, tmp_path: Path
) -> None:
    found, returns, stays_off = broken(bench_of, kind, range(100 + 30 * part, 130 + 30 * part), tmp_path)
    assert found == []
    assert returns and not stays_off

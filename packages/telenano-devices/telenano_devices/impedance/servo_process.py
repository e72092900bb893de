"""The process of a servo: it runs the coupling at the rate of a device of impedance type, beside the node's loop.

The node starts this module as a program and writes one line of JSON to its input, with the device and the file of the
shared memory; the process answers with one line, the capabilities of the device or the reason why it is not there.
After that both communicate through shared memory. The force is zero after 50 ms without a command of the node, and the
process ends with the node.
"""

import contextlib
import json
import mmap
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from telenano.extend.hands import Capabilities, DeviceError
from telenano.runtime import schedule_as_node, start_process
from telenano.settings import DeviceDriver
from telenano.wire import cause
from telenano_devices.impedance.coupling import Vector
from telenano_devices.impedance.impedance_wire import Impedance, ImpedanceWire
from telenano_devices.impedance.servo import DeviceSample, Servo, ServoCommand, ServoSample, Slot

RETRY_S = 0.5
_SERVO = "telenano_devices.impedance.servo_process"
OPEN_S = 15.0
_POLL_S = 0.01
# The largest first answer of a servo [bytes]; it usually has some hundred bytes.
_LONGEST_ANSWER = 1 << 20
_END_S = 1.0
# The longest step of the servo's filters, even after a longer stall.
_LONGEST_STEP_S = 0.05
_SHARED_MEMORY = Path("/dev/shm")
# The flags that the node sets for the servo: a session runs, and the servo has to end.
_RUNS = 1
_STOP = 2
# The position before the first sample [m].
_NOWHERE = (0.0, 0.0, 0.0)


class SharedServo:
    """The memory shared by both processes: a command, a sample and a byte of flags, in a writable buffer of `SIZE`."""

    SIZE = 2 * Slot.size + 1

    def __init__(self, buffer: Any) -> None:
        self._buffer, whole = buffer, memoryview(buffer)
        self._command, self._sample = Slot(ServoCommand), Slot(ServoSample)
        self._places = whole[: Slot.size], whole[Slot.size : -1]
        self._flags = whole[-1:]
        self._seen = b""
        self._newest: ServoCommand | None = None

    def command(self) -> ServoCommand | None:
        """Return the newest command; an unchanged one is not decoded again, to save time in a servo of 4 kHz."""
        raw = bytes(self._places[0])
        if raw != self._seen:
            self._newest, self._seen = self._command.read(self._places[0]), raw
        return self._newest

    def write_command(self, command: ServoCommand) -> None:
        self._command.write(self._places[0], command)

    def sample(self) -> ServoSample | None:
        return self._sample.read(self._places[1])

    def write_sample(self, sample: ServoSample) -> None:
        self._sample.write(self._places[1], sample)

    def flag(self, runs: bool, stop: bool) -> None:
        """Set the flags: whether the session runs, and whether the servo has to end."""
        self._flags[0] = _RUNS * runs + _STOP * stop

    @property
    def session_runs(self) -> bool:
        return bool(self._flags[0] & _RUNS)

    @property
    def stops(self) -> bool:
        return bool(self._flags[0] & _STOP)

    def close(self) -> None:
        for place in (*self._places, self._flags):
            place.release()
        if isinstance(self._buffer, mmap.mmap):
            with contextlib.suppress(BufferError):
                self._buffer.close()


class ServoLoop:
    """The servo of one device, at the device's side of the shared memory.

    Args:
        shared: The memory.
        wire: The opened device.
        found: Its capabilities; after a loss a device with another identity is refused.
        now_ns: The monotonic clock [ns]; a test replaces it.
        sleep: The function that waits while the device is lost.
        is_needed: The function that returns whether the node is still there.
    """

    def __init__(
        self,
        shared: SharedServo,
        wire: ImpedanceWire,
        found: Capabilities,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
        is_needed: Callable[[], bool] = lambda: True,
    ) -> None:
        self._shared, self._wire, self._found = shared, wire, found
        self._now_ns, self._sleep, self._is_needed = now_ns, sleep, is_needed
        self._period_s = 1.0 / found.rate_hz
        self.servo = Servo(self._period_s)
        self._sample = DeviceSample(_NOWHERE, 0)
        self._turn_ns = 0
        self._session_runs = False

    def run(self) -> None:
        """Serve the device until the node ends; after a loss try to open it again every half second."""
        error = ""
        while not error or self._reopened(error):
            try:
                self._wire.run(self.turn)
                return
            except Exception as lost:  # noqa: BLE001
                error = cause(lost)
            finally:
                self._let_go()

    def turn(self, sample: DeviceSample) -> Vector | None:
        """Return the force for a sample [N], and report to the node; None if the node is gone or ends the servo."""
        if self._ends():
            return None
        if self._shared.session_runs != self._session_runs:
            self._session_runs = not self._session_runs
            self._wire.session(self._session_runs)
        return self._step(sample)

    def _ends(self) -> bool:
        return self._shared.stops or not self._is_needed()

    def _step(self, sample: DeviceSample) -> Vector:
        now_ns = self._now_ns()
        # If the process stalls between a reading and its step, the next step follows at once. The hand has moved during
        # the whole time between the two readings; within the short time between the steps it would seem to jump.
        passed_ns = max(now_ns - self._turn_ns, sample.taken_ns - self._sample.taken_ns)
        passed_s = passed_ns * 1e-9 if self._turn_ns else self._period_s
        self._turn_ns, self._sample = now_ns, sample
        command = self._shared.command()
        force, report = self.servo.step(command, sample, now_ns, min(max(passed_s, 1e-6), _LONGEST_STEP_S))
        self._shared.write_sample(report)
        return force

    def _reopened(self, error: str) -> bool:
        """Wait until the device is back, reporting the error to the node; return False if the node ends before."""
        waited_s = 0.0
        while not self._ends():
            self._step(self._sample._replace(error=error))
            self._sleep(_POLL_S)
            waited_s += _POLL_S
            if waited_s < RETRY_S:
                continue
            waited_s = 0.0
            try:
                capabilities = self._wire.open()
                if capabilities.identity == self._found.identity:
                    # The state of the coupling is from before the loss, so it begins again with the hand at rest.
                    self.servo.state = self.servo.state._replace(started=False)
                    self._session_runs = False
                    return True
                error = f"{capabilities.identity} is connected instead of {self._found.identity}: restart the node"
            except Exception as still:  # noqa: BLE001
                error = cause(still)
            self._let_go()
        return False

    def _let_go(self) -> None:
        with contextlib.suppress(Exception):
            self._wire.close()


class ProcessLink:
    """A `ServoLink` to a device whose servo is a process of its own.

    Args:
        kind: The name of the driver.
        settings: The settings of its section.
    """

    def __init__(self, kind: str, settings: dict[str, Any]) -> None:
        self._kind, self._settings = kind, settings
        self._process: subprocess.Popen[bytes] | None = None
        self._shared: SharedServo | None = None
        self._file: Path | None = None
        self._found: Capabilities | None = None
        self._retry_ns = 0

    @property
    def capabilities(self) -> Capabilities:
        """Return the capabilities that the device reported; raise DeviceError before `open`."""
        if self._found is None:
            raise DeviceError(f"haptic_node.{self._kind}: what the device can do is known once it is open")
        return self._found

    @property
    def pid(self) -> int:
        """Return the process id of the servo, 0 if there is none."""
        return 0 if self._process is None else self._process.pid

    def open(self) -> None:
        """Start the servo and wait until it has opened the device.

        Raises:
            DeviceError: The device is not there, with the message of its driver, or the servo does not answer.
        """
        self._start()
        assert self._process is not None and self._process.stdout is not None
        answer = b""
        end_s = time.monotonic() + OPEN_S
        while not answer.endswith(b"\n"):
            ready, _, _ = select.select([self._process.stdout], [], [], max(0.0, end_s - time.monotonic()))
            part = os.read(self._process.stdout.fileno(), 65_536) if ready else b""
            if not part or len(answer) > _LONGEST_ANSWER:
                self.close()
                what = f"answered nothing for {OPEN_S:g} s" if not ready else "ended; its reason is in the log above"
                raise DeviceError(f"the servo of haptic_node.driver {self._kind} {what}")
            answer += part
        document = json.loads(answer)
        if "error" in document:
            self.close()
            raise DeviceError(document["error"])
        self._found = Capabilities(**{name: _as_tuples(value) for name, value in document["found"].items()})

    def send(self, command: ServoCommand) -> None:
        if self._shared is not None:
            self._shared.write_command(command)

    def newest(self, session_time_s: float, dt_s: float) -> ServoSample | None:
        if self._shared is None or self._process is None:
            return None
        self._shared.flag(session_time_s >= 0.0, False)
        code = self._process.poll()
        if code is None:
            return self._shared.sample()
        # The force ended with the process: service and device remove it when no command comes.
        error = f"the process of the servo has ended with code {code}; it is started again"
        if time.monotonic_ns() >= self._retry_ns:
            self._retry_ns = time.monotonic_ns() + round(RETRY_S * 1e9)
            self._end()
            self._start()
        return (self._shared.sample() or ServoSample())._replace(error=error)

    def close(self) -> None:
        if self._shared is not None:
            self._shared.flag(False, True)
        self._end()
        if self._shared is not None:
            self._shared.close()
            self._shared = None
        if self._file is not None:
            self._file.unlink(missing_ok=True)
            self._file = None

    def _start(self) -> None:
        folder = _SHARED_MEMORY if _SHARED_MEMORY.is_dir() else None
        if self._shared is None:
            descriptor, name = tempfile.mkstemp(prefix="telenano-servo-", dir=folder)
            try:
                os.ftruncate(descriptor, SharedServo.SIZE)
                self._shared = SharedServo(mmap.mmap(descriptor, SharedServo.SIZE))
                self._file = Path(name)
            finally:
                os.close(descriptor)
        self._process = start_process(_SERVO)
        assert self._process.stdin is not None
        order = {"kind": self._kind, "settings": self._settings, "shared": str(self._file)}
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            self._process.stdin.flush()

    def _end(self) -> None:
        if self._process is None:
            return
        process = self._process
        ends: tuple[Callable[[], None], ...] = (lambda: None, process.terminate, process.kill)
        for end in ends:
            end()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
                break
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        self._process = None


def wire_of(kind: str, settings: dict[str, Any]) -> ImpedanceWire:
    """Return the wire of a driver; only the package of this driver is imported.

    Raises:
        ConfigError: The settings do not fit the driver.
        DeviceError: There is no such driver, or its device takes no force.
    """
    driver = DeviceDriver.haptic(kind)
    if driver is None or not isinstance(driver.own, Impedance):
        raise DeviceError(f"there is no wire called {kind!r}")
    return driver.own.wire(driver.settings(settings))


def main() -> int:
    """Serve the device that the node names; return 0, or 2 if it could not be opened."""
    parent = os.getppid()
    # The node ends the servo through the shared memory. Ctrl-C is ignored, because it reaches the whole process group.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: ended.append(number))
    order = json.loads(sys.stdin.readline())
    with Path(order["shared"]).open("r+b") as file:
        shared = SharedServo(mmap.mmap(file.fileno(), SharedServo.SIZE))
    try:
        wire = wire_of(order["kind"], order["settings"])
        capabilities = wire.open()
    except Exception as error:  # noqa: BLE001
        _answer({"error": cause(error)})
        return 2
    try:
        _answer({"found": capabilities._asdict()})
        schedule_as_node("servo")
        ServoLoop(shared, wire, capabilities, is_needed=lambda: not ended and os.getppid() == parent).run()
        return 0
    finally:
        wire.close()
        if os.getppid() != parent:
            # A killed node could not remove the file.
            Path(order["shared"]).unlink(missing_ok=True)


def _answer(answer: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value


if __name__ == "__main__":
    sys.exit(main())

"""What the drivers of instruments behind a TCP connection have in common: ticks that never wait.

A loss is a state, which the report tells: the connection is made again, and the talk with the instrument begins at its
beginning. After that the base stays retracted until the guard of the node has it there as well.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from telenano.devices.afm import modbus_line
from telenano.devices.afm.converter_calibration import Readings
from telenano.devices.afm.modbus_line import LOST_NS, STEP_NS, Connect, Line, TcpConnector, continue_connecting
from telenano.extend.instruments import AfmReport, DeviceError, SafetyParams
from telenano.extend.samples import AfmSample
from telenano.wire.errors import cause

# A retraction on the connection that is there waits for its answer for this time.
_CLOSE_S = 0.1
# A retraction on a new connection waits for this time.
_RECONNECT_S = 0.3
# The line is read at this interval while the driver waits.
_POLL_S = 1e-3


class Address(Protocol):
    """Where an instrument is reached."""

    @property
    def host(self) -> str: ...

    @property
    def port(self) -> int: ...


class Calibration(Protocol):
    """What a calibration has for every driver: where the instrument is, and what a recording names the file by."""

    @property
    def network(self) -> Address: ...

    @property
    def identity(self) -> str: ...


C = TypeVar("C", bound=Calibration)


class TcpDriver(ABC, Generic[C]):
    """An `AfmDriver` of an instrument behind a TCP connection.

    Args:
        calibration: The calibration of this very instrument.
        limits: The limits of the node's guard.
        model: What the instrument is called.
        readings: The readings in the safe state, until there is a sample.
        period_s: The period of the loop [s].
        connect: Connects to the instrument; a test replaces it.
        now_ns: The monotonic clock [ns]; a test replaces it.
        sleep: Waits in `open`, `retract` and `close`, and nowhere else.
    """

    # An instrument that is silent for longer than this is lost, and one that does not answer an order of the handshake.
    LOST_NS: ClassVar[int] = LOST_NS
    STEP_NS: ClassVar[int] = STEP_NS
    # A reading is fresh up to an age of this number of cycles.
    STALE_CYCLES: ClassVar[int] = 3

    state = None
    vibration = None
    simulation = None
    relief = None
    # This is the name of the device in messages.
    kind: ClassVar[str] = "instrument"

    def __init__(
        self,
        calibration: C,
        limits: SafetyParams,
        model: str,
        readings: Readings,
        *,
        period_s: float = 1e-3,
        connect: Connect | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.calibration: C = calibration
        self._limits, self._model = limits, model
        self._where = f"{calibration.network.host}:{calibration.network.port}"
        self._connect: Connect = TcpConnector() if connect is None else connect
        self._now_ns, self._sleep, self._period_s = now_ns, sleep, period_s
        self._line: Line | None = None
        # the handshake, and with some instruments all that comes after it; None while the connection is being made
        self._talk: Generator[Any, Any, None] | None = None
        self._ready = self._opened = False
        # After a (re)connection the base stays retracted until the guard has it there as well.
        self._released = False
        self._begun_ns = self._sent_ns = self._retry_ns = self._sampled_ns = 0
        # samples on this connection
        self.exchanges = 0
        # how often the guard or the script in front of the tip has retracted it; None where there is none
        self.retractions: int | None = None
        self._text = ""
        self._readings = readings
        self._report = AfmReport("lost", 0.0, True, f"the {self.kind} is not open")

    @abstractmethod
    def _restart(self) -> None:
        """Forget what was said on an earlier connection."""

    @abstractmethod
    def _begin_talk(self, now_ns: int, line: Line) -> None:
        """Send the first request on a connection that is there now."""

    @abstractmethod
    def _continue_exchange(self, now_ns: int, line: Line, talk: Generator[Any, Any, None] | None) -> None:
        """Take the answer if it is there, and send the request that is due; what is raised loses the connection."""

    @abstractmethod
    def _want(self, base_m: float) -> None:
        """Have a base position [m] sent from now on; until it is released, that is the safe one."""

    @abstractmethod
    def _want_safe(self) -> None:
        """Have the safe position sent from now on, and count from here what `_is_safe` is about."""

    @abstractmethod
    def _is_safe(self) -> bool:
        """Return whether the instrument was found in the safe position since `_want_safe`."""

    @abstractmethod
    def _judge(self, now_ns: int) -> None:
        """Renew the report."""

    @property
    @abstractmethod
    def latency_s(self) -> float:
        """Return what the instrument is declared to add to the round trip, in the mean [s]."""

    @property
    @abstractmethod
    def safe_position_m(self) -> float:
        """Return the base position of the safe state [m]."""

    @property
    def report(self) -> AfmReport:
        return self._report

    @property
    def identity(self) -> str:
        """Return who the instrument is, for a person; known once it is open."""
        return self._model

    @property
    def calibration_identity(self) -> str:
        return self.calibration.identity

    def open(self) -> None:
        """Connect, identify, set up, retract and take a first sample.

        Raises:
            DeviceError: The instrument is absent or another one; the message says what was found.
            RuntimeError: It is open already.
        """
        if self._opened:
            raise RuntimeError(f"the {self.kind} is already open")
        self._opened = True
        self._begin(self._now_ns())
        while not (self._ready and self.exchanges):
            if self._line is None:
                self._opened = False
                raise DeviceError(self._text)
            self._sleep(_POLL_S)
            self._poll(self._now_ns())
        self._judge(self._now_ns())

    def exchange(self, base_m: float) -> AfmSample:
        """Apply a base position [m] and return the newest sample; `report` has its age and state."""
        if not abs(base_m) < float("inf"):
            raise ValueError(f"base position {base_m} m must be finite")
        if not self._opened:
            raise RuntimeError(f"the {self.kind} is not open: call open() first")
        self._released |= self._ready and base_m <= self._limits.retract_position_m
        self._want(base_m)
        now_ns = self._now_ns()
        self._poll(now_ns)
        self._judge(now_ns)
        return self._readings.sample

    def retract(self) -> bool:
        """Send the safe position, on a new connection if need be; return whether the tip was found there since.

        Waits 0.1 s at most, and 0.3 s for a new connection.
        """
        if not self._opened:
            return False
        self._released = False
        self._want_safe()
        wait_s = _CLOSE_S
        if not self._ready:
            wait_s = _RECONNECT_S
            self._drop(self._now_ns())
            self._begin(self._now_ns())
        connected, until_ns = self._line, self._now_ns() + round(wait_s * 1e9)
        while self._line is connected is not None and self._now_ns() < until_ns:
            self._poll(self._now_ns())
            # The answer that was under way at the beginning says nothing of the retraction.
            if self._is_safe():
                return True
            self._sleep(_POLL_S)
        return False

    def close(self) -> None:
        """Retract and disconnect; harmless when already closed."""
        if self._ready:
            self.retract()
        self._drop(self._now_ns())
        self._opened = False

    def _begin(self, now_ns: int) -> None:
        self._retry_ns = now_ns + modbus_line.RETRY_NS
        self._released = self._ready = False
        self.exchanges = 0
        self._restart()
        try:
            self._line = self._connect(self.calibration.network.host, self.calibration.network.port)
        except OSError as error:
            self._lose(now_ns, f"cannot be reached: {error.strerror or error}")
            return
        self._sent_ns = self._begun_ns = now_ns

    def _drop(self, now_ns: int) -> None:
        if self._line is not None:
            self._line.close()
        self._line = self._talk = None
        self._ready = False
        self._retry_ns = now_ns + modbus_line.RETRY_NS

    def _lose(self, now_ns: int, text: str) -> None:
        self._text = f"{self._where}: {self._model}: {text}"
        self._drop(now_ns)

    def _poll(self, now_ns: int) -> None:
        """Do what can be done now; nothing is raised, a loss is a state."""
        try:
            if self._line is None:
                if self._opened and now_ns >= self._retry_ns:
                    self._begin(now_ns)
            elif self._ready or self._talk is not None:
                self._continue_exchange(now_ns, self._line, self._talk)
            else:
                connected, self._sent_ns = continue_connecting(self._line, now_ns, self._begun_ns, self._sent_ns)
                if connected:
                    self._begin_talk(now_ns, self._line)
        except Exception as error:  # noqa: BLE001
            self._lose(now_ns, cause(error))

    def _come_up(self, identity: str) -> None:
        self._ready = True
        self._text = f"{self._where}: {identity} is ready and retracted, calibration {self.calibration.identity}"

    def _age_s(self, now_ns: int) -> float:
        """Return the age of the sample, from the oldest moment at which it can have been taken [s]; 0 without one."""
        return max(now_ns - self._sampled_ns, 0) * 1e-9 if self._sampled_ns else 0.0

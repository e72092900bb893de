"""The common base of drivers of instruments behind a TCP connection, whose ticks never wait.

A loss of the connection is a state, shown in the report, and no exception: the driver connects again and repeats the
handshake. After that the base stays retracted until the guard of the node has retracted it too.
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

# Time to wait for the answer to a retraction on an existing connection.
_CLOSE_S = 0.1
# Time to wait for it on a new connection.
_RECONNECT_S = 0.3
# Interval at which the line is read while the driver waits.
_POLL_S = 1e-3


class Address(Protocol):
    """The network address of an instrument."""

    @property
    def host(self) -> str: ...

    @property
    def port(self) -> int: ...


class Calibration(Protocol):
    """The properties of every calibration: network address of the instrument, and its name in recordings."""

    @property
    def network(self) -> Address: ...

    @property
    def identity(self) -> str: ...


C = TypeVar("C", bound=Calibration)


class TcpDriver(ABC, Generic[C]):
    """An `AfmDriver` of an instrument behind a TCP connection.

    Args:
        calibration: The calibration of this particular instrument.
        limits: The limits of the node's guard.
        model: The name of the model of the instrument.
        readings: The readings in the safe state, used until there is a sample.
        period_s: The period of the loop [s].
        connect: The function that connects to the instrument; a test replaces it.
        now_ns: The monotonic clock [ns]; a test replaces it.
        sleep: The function that waits; only `open`, `retract` and `close` call it.
    """

    # An instrument is lost that is silent for longer than LOST_NS, or in the handshake for longer than STEP_NS.
    LOST_NS: ClassVar[int] = LOST_NS
    STEP_NS: ClassVar[int] = STEP_NS
    # A reading is fresh up to an age of this many cycles.
    STALE_CYCLES: ClassVar[int] = 3

    state = None
    vibration = None
    simulation = None
    relief = None
    # The name of the device in messages.
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
        # The handshake, which for some instruments includes all later exchanges; None while connecting.
        self._talk: Generator[Any, Any, None] | None = None
        self._ready = self._opened = False
        # After each connection the base stays retracted until the guard has retracted it too.
        self._released = False
        self._begun_ns = self._sent_ns = self._retry_ns = self._sampled_ns = 0
        # Number of samples on this connection.
        self.exchanges = 0
        # Number of retractions by the guard or script in front of the tip; None if there is none.
        self.retractions: int | None = None
        self._text = ""
        self._readings = readings
        self._report = AfmReport("lost", 0.0, True, f"the {self.kind} is not open")

    @abstractmethod
    def _restart(self) -> None:
        """Reset the state of the exchange for a new connection."""

    @abstractmethod
    def _begin_talk(self, now_ns: int, line: Line) -> None:
        """Send the first request on a connection that was just made."""

    @abstractmethod
    def _continue_exchange(self, now_ns: int, line: Line, talk: Generator[Any, Any, None] | None) -> None:
        """Take the answer if it has come, and send the next request; any exception loses the connection."""

    @abstractmethod
    def _want(self, base_m: float) -> None:
        """Set the base position [m] to send from now on; until the base is released, the safe one is sent."""

    @abstractmethod
    def _want_safe(self) -> None:
        """Send the safe position from now on, and begin to count the samples that `_is_safe` needs."""

    @abstractmethod
    def _is_safe(self) -> bool:
        """Return whether the instrument was found in the safe position since `_want_safe`."""

    @abstractmethod
    def _judge(self, now_ns: int) -> None:
        """Renew the report."""

    @property
    @abstractmethod
    def latency_s(self) -> float:
        """Return the declared mean latency that the instrument adds to the round trip [s]."""

    @property
    @abstractmethod
    def safe_position_m(self) -> float:
        """Return the base position of the safe state [m]."""

    @property
    def report(self) -> AfmReport:
        return self._report

    @property
    def identity(self) -> str:
        """Return a description of the instrument for a person; known once it is open."""
        return self._model

    @property
    def calibration_identity(self) -> str:
        return self.calibration.identity

    def open(self) -> None:
        """Connect, run the handshake, which leaves the instrument retracted, and take a first sample.

        Raises:
            DeviceError: The instrument is absent or another one; the message gives the finding.
            RuntimeError: The instrument is open already.
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
        """Apply a base position [m] and return the newest sample; `report` gives its age and the device's state."""
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
        """Send the safe position, on a new connection if necessary; return whether the instrument confirmed it.

        This waits at most 0.1 s, or 0.3 s on a new connection.
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
            # An answer that was under way when the retraction was sent does not confirm it.
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
        """Advance connection, handshake or exchange without waiting; a loss is a state, and nothing is raised."""
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
        """Return the age of the sample [s], from the earliest time at which it can have been taken; 0 without one."""
        return max(now_ns - self._sampled_ns, 0) * 1e-9 if self._sampled_ns else 0.0

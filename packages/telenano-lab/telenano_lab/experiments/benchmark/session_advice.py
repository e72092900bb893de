"""Adviser of the benchmark: warn if the running session is outside the conditions that its law was shown to hold.

It only gives advice, and never acts on a device.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from types import MappingProxyType
from typing import ClassVar

from telenano.extend.advice import Advice, AdvisedSession
from telenano.sections import LAWS, ControllerConfig
from telenano.settings import section_of
from telenano.wire import AfmState, LawStatus, Message, Scalar
from telenano_lab.experiments.benchmark.session_estimates import ContactEstimate, LineEstimate
from telenano_lab.experiments.benchmark.shown_range import Estimate, LawRange, Session, advice, outside, read_shown

# Interval of the checks [ns].
_LOOK_NS = 500_000_000
# A session counts as outside after the first time, and as inside again after the second [ns].
_OUTSIDE_NS = 2_000_000_000
_INSIDE_NS = 10_000_000_000
_UNITS = ("round_trip_ms", "unevenness_ms", "stiffness_n_per_m", "drift_pm_per_s")


class BenchmarkAdviser:
    """Watches the session: its estimates, and whether a warning is in force."""

    inputs: ClassVar[tuple[str, ...]] = ("law/status", "afm/state")

    def __init__(
        self,
        now_ns: Callable[[], int],
        laws: Collection[str],
        absent_laws: Mapping[str, str] = MappingProxyType({}),
        read_table: Callable[[], Mapping[str, LawRange]] = read_shown,
    ) -> None:
        """Prepare to watch.

        Args:
            now_ns: Returns the time on the monotonic clock [ns].
            laws: The laws whose settings are those of the benchmark.
            absent_laws: The laws that are not installed, each with the place where it is available.
            read_table: Returns the conditions that each law was shown to hold.
        """
        self._now_ns, self._laws, self._absent_laws = now_ns, frozenset(laws), absent_laws
        self._read_table = read_table
        self._line, self._contact = LineEstimate(), ContactEstimate()
        self._law = ""
        self._hears_master = False
        self._look_ns = now_ns()
        # Start of the time for which the session has been outside, or back inside, without an exception.
        self._since_ns: int | None = None
        # The estimates at the time of the warning; None while no warning is in force.
        self._warned: Session | None = None

    def look(self, messages: Iterable[Message], *, runs: bool) -> Advice | None:
        """Return a warning if the session has left the conditions that its law was shown to hold."""
        self.take(messages, runs=runs)
        return self._judged() if runs else None

    def take(self, messages: Iterable[Message], *, runs: bool) -> None:
        """Record messages; those of the line only while the session runs."""
        for message in messages:
            if isinstance(message, AfmState):
                _, _, base_m = message.base_position_m
                touches = message.in_contact and message.mode == "follow" and message.felt_channel is None
                self._contact.record(1e-9 * message.t_ns, 0.0 - base_m, message.tip_force_n[2], touches=touches)
            elif isinstance(message, LawStatus):
                # The round trip is measured at the master's half; the slave's may briefly be at another law.
                self._hears_master |= message.round_trip_valid
                if self._hears_master and not message.round_trip_valid:
                    continue
                if message.law != self._law:
                    self._law, self._warned, self._since_ns = message.law, None, None
                if not runs:
                    self._line.forget()
                elif message.round_trip_valid:
                    self._line.record(1e-9 * message.t_ns, message.round_trip_s)

    def session(self) -> Session:
        """Return the estimates of the session."""
        line, stiffness, drift = self._line.estimate(), self._contact.stiffness(), self._contact.drift()
        there, uneven = line if line is not None else (None, None)
        return Session(
            there,
            uneven,
            stiffness if isinstance(stiffness, Estimate) else None,
            drift if isinstance(drift, Estimate) else None,
        )

    def _judged(self) -> Advice | None:
        now_ns = self._now_ns()
        table = self._read_table()
        if now_ns < self._look_ns or self._law not in table or self._law not in self._laws:
            return None
        self._look_ns = now_ns + _LOOK_NS
        session = self.session()
        axis = outside(table[self._law], session)
        if self._warned is None:
            if not self._lasts(axis is not None, _OUTSIDE_NS, now_ns) or axis is None:
                return None
            self._warned, self._since_ns = session, None
            choices = [law for law in LAWS if law in self._laws]
            text = advice(table, self._law, axis, session, choices, self._absent_laws)
            return Advice(text, {"outside": axis, "law": self._law, **_facts(session)})
        # A figure that is no longer known is not known to be inside.
        is_known = all(new is not None for old, new in zip(self._warned, session, strict=True) if old is not None)
        if self._lasts(axis is None and is_known, _INSIDE_NS, now_ns):
            self._warned, self._since_ns = None, None
        return None

    def _lasts(self, is_so: bool, for_ns: int, now_ns: int) -> bool:
        """Return whether a condition has held without a break for a time [ns]."""
        if not is_so:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = now_ns
        return self._since_ns is not None and now_ns - self._since_ns >= for_ns


def benchmark_adviser(session: AdvisedSession) -> BenchmarkAdviser | None:
    """Return the adviser of a session; None if no law has the settings that the benchmark ran."""
    laws = laws_as_shown(session.controller)
    return BenchmarkAdviser(session.now_ns, laws, session.absent_laws) if laws else None


def laws_as_shown(controller: ControllerConfig) -> list[str]:
    """Return the laws whose settings in a scenario are those that the benchmark ran."""
    plain = ControllerConfig()
    shared = ("period_s", "deadband", "clamp", "lateral")
    if any(getattr(controller, name) != getattr(plain, name) for name in shared):
        return []
    return [law for law in LAWS if section_of(controller, law) == section_of(plain, law)]


def _facts(session: Session) -> dict[str, Scalar]:
    return {
        f"{part}{name}": round(value, 3)
        for name, estimate in zip(_UNITS, session, strict=True)
        if estimate is not None
        for part, value in zip(("", "least_", "most_"), estimate, strict=True)
    }

"""An image or a force curve taken by a running rig: begin a program of the instrument and collect its data."""

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from telenano.console import holding, send_control
from telenano.runtime import RIG_HINT, Command, Observer
from telenano.signals import held
from telenano.wire import AfmProgram, AfmScanline, AfmState, NodeHealth, RigError, Scalar
from telenano_lab.microscopy.image_files import LiveImage

# Address of the instrument of a rig.
TIP = "afm_node@slave"

_TOPICS = ("afm/scanline", "afm/program", "node/health")
# The instrument reports twice a second, and ten times a second while a program runs.
_PATIENCE_S = 4.0
_LISTEN_S = 0.1
_OVER_S = 1.0


@dataclass
class LiveCurve:
    """A force curve so far, in the order of time: base x_s [m], deflection [m] and force on the tip [N]."""

    base_m: list[float] = field(default_factory=list)
    deflection_m: list[float] = field(default_factory=list)
    force_n: list[float] = field(default_factory=list)

    def add(self, state: AfmState) -> None:
        """Append the sample in a state of the instrument."""
        self.base_m.append(0.0 - state.base_position_m[2])
        self.deflection_m.append(state.deflection_m)
        self.force_n.append(state.tip_force_n[2])


def run_program(
    site_file: Path,
    parameters: Mapping[str, Scalar],
    collected: LiveImage | LiveCurve,
    on_report: Callable[[AfmProgram], str],
) -> AfmProgram:
    """Begin a program at the instrument of a running rig and collect its data until it is over.

    Ctrl-C and SIGTERM end the program and retract the tip; a second one does not wait for the end.

    Args:
        site_file: The site file of the rig.
        parameters: The parameters of the `set` command that begins the program.
        collected: Receives the data of the program.
        on_report: Called with each report of the program, and several times a second without a new one; its return
            value (pause, resume, abort or the empty string) is sent to the instrument.

    Returns:
        The last report.

    Raises:
        RigError: No rig is running, the program is refused, or the instrument falls silent.
    """
    topics = (*_TOPICS, "afm/state") if isinstance(collected, LiveCurve) else _TOPICS
    with closing(Observer.of_rig(site_file, topics)) as observer:
        _await_instrument(observer)
        listener = _Listener(observer, collected)

        def send(word: str) -> None:
            _send(site_file, {"program": word})

        with holding("program"):
            try:
                # If the instrument may have begun, it must also be told to end.
                with held():
                    _send(site_file, parameters)
                return listener.listen(on_report, send)
            except KeyboardInterrupt:
                return _aborted(listener, send)


def _aborted(listener: "_Listener", send: Callable[[str], None]) -> AfmProgram:
    """End the program and return its last report; raise RigError if the abort fails while the program continues."""
    try:
        with held():
            try:
                send("abort")
            except RigError:
                # A program that is already over rejects the abort.
                if not listener.is_over():
                    raise
        return listener.listen(lambda report: "", lambda word: None)
    except KeyboardInterrupt:
        if listener.report is None:
            raise
        return listener.report


class _Listener:
    """Collects the data and reports that a program publishes."""

    def __init__(self, observer: Observer, collected: LiveImage | LiveCurve) -> None:
        self._observer, self._collected = observer, collected
        self.report: AfmProgram | None = None
        self._heard_s = time.monotonic()

    def listen(self, on_report: Callable[[AfmProgram], str], send: Callable[[str], None]) -> AfmProgram:
        """Listen until the program is over and return its last report; RigError if the instrument falls silent."""
        while True:
            for observed in self._observer.listen(_LISTEN_S):
                self._take(observed.received.message)
            report = self.report
            if report is not None and report.state in ("finished", "ended"):
                on_report(report)
                return report
            if time.monotonic() - self._heard_s > _PATIENCE_S:
                raise RigError(f"{TIP} has reported nothing of its program for {_PATIENCE_S:g} s: {RIG_HINT}")
            if report is not None and (word := on_report(report)):
                send(word)

    def is_over(self) -> bool:
        """Return whether the program is over; listen for a second, within which the instrument reports."""
        for observed in self._observer.listen(_OVER_S):
            self._take(observed.received.message)
        return self.report is not None and self.report.state in ("finished", "ended")

    def _take(self, message: object) -> None:
        if isinstance(message, AfmProgram):
            # An earlier program was over before this one began.
            if self.report is None and message.state in ("finished", "ended"):
                return
            self.report, self._heard_s = message, time.monotonic()
            return
        collected = self._collected
        if isinstance(collected, LiveImage):
            if isinstance(message, AfmScanline):
                collected.add(message)
        elif isinstance(message, AfmState) and self._runs():
            collected.add(message)

    def _runs(self) -> bool:
        return self.report is not None and self.report.state == "running"


def _await_instrument(observer: Observer) -> None:
    """Wait until a message of the instrument is received, so that none of its reports on the program is missed."""
    end_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end_s:
        for observed in observer.listen(_LISTEN_S):
            message = observed.received.message
            if isinstance(message, NodeHealth) and message.src == TIP:
                return
    raise RigError(f"nothing is received from {TIP}: {RIG_HINT}")


def _send(site_file: Path, parameters: Mapping[str, Scalar]) -> None:
    answers = send_control(Command("set", TIP, parameters=parameters), site_file, "master", lambda event: None)
    for event in answers.values():
        if event.kind == "refused":
            raise RigError(f"{event.src} refused it: {event.text}")

"""Watchdog of the launcher: detects processes of this machine that hang, from their reports and their processor time.

A node that hangs and one that does not get a processor are both silent. Their processor time distinguishes them: a loop
that never returns to its messages uses all it can get, and a process that is stopped or waits for a processor uses
none. Only a hanging process is killed; the others are reported, and continue when they can.

On one machine the reports of the slave's nodes cross the link on their way to the launcher. While the process of the
link is started again they cannot arrive, and no silence counts for these nodes.

The limit that the nodes of the loop set themselves (`telenano/runtime/loop/hang_guard.py`) cannot replace the watchdog:
recorder and page have none, and a stopped or starved node uses no processor time and so never reaches it.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from telenano.timing.clock import Clock
from telenano.wire.nodes import RECORDER, name_of

# Silence after which a node is judged [s]; it publishes node/health twice a second.
SILENCE_S = 2.0
# Busy time after which a silent recorder counts as hung [s]; it writes the index of a long file without reporting.
RECORDER_BUSY_S = 120.0
# Least share of the wall time that a hanging process uses; below it, the process did not get the processor.
BUSY_SHARE = 0.8
# Interval of samples of a process [s]; the kernel counts in hundredths of a second.
LOOK_S = 0.25
# States of proc(5) in which a signal or a debugger has stopped the process.
_STOPPED = ("T", "t")
# Indices of fields in /proc/PID/stat behind the name in parentheses.
_STATE = 0
_USER_TICKS = 11
_SYSTEM_TICKS = 12

Kind = Literal["hung", "stopped", "starved", "unknown", "paused", "back"]


class ProcessSample(NamedTuple):
    """State of a process in one letter, as in proc(5), and the processor time that it has used [s]."""

    state: str
    cpu_s: float


class ProcessTimes(Protocol):
    """Source of samples of processes for a watchdog."""

    def read(self, process_id: int) -> ProcessSample:
        """Return the present sample of a process; OSError or ValueError if there is none."""


class ProcFiles:
    """Samples from /proc on Linux, for processes of the same user."""

    def __init__(self, folder: Path = Path("/proc")) -> None:
        self._folder = folder
        self._tick_s = 1.0 / os.sysconf("SC_CLK_TCK")

    def read(self, process_id: int) -> ProcessSample:
        """Return the present sample of a process; OSError or ValueError if there is none."""
        text = (self._folder / str(process_id) / "stat").read_text()
        # The name may contain any character, even parentheses and spaces.
        fields = text.rpartition(")")[2].split()
        if len(fields) <= _SYSTEM_TICKS:
            raise ValueError(f"{self._folder}/{process_id}/stat has {len(fields)} fields behind the name")
        ticks = int(fields[_USER_TICKS]) + int(fields[_SYSTEM_TICKS])
        return ProcessSample(fields[_STATE], ticks * self._tick_s)


@dataclass(frozen=True)
class Finding:
    """A finding on a node; `text` is a sentence on it, and `silence_s` the time since its last report [s].

    The kind `paused` concerns the launcher or the whole machine, and has an empty node.
    """

    node: str
    kind: Kind
    silence_s: float
    text: str


class _Watched:
    """Observations of a process since its last report."""

    def __init__(self, process_id: int) -> None:
        self.process_id = process_id
        self.reported: Kind | None = None
        # None before the first report, because the start of a process may take any time.
        self.last_ns: int | None = None
        self.looked_ns = 0
        self.sample: ProcessSample | None = None
        self.why_not = ""
        # Part of the silence during which the launcher was running, and time for which the process has been using a
        # processor without a pause [s].
        self.silence_s = self.busy_s = 0.0


class Watchdog:
    """Detects own nodes that are silent for two seconds, and distinguishes those that hang from those that wait.

    Args:
        clock: The clock of the rig.
        times: The source of samples of the processes.
        carriers: The node whose process passes on the reports of another one, by the other one.
    """

    def __init__(self, clock: Clock, times: ProcessTimes, carriers: Mapping[str, str] | None = None) -> None:
        self._clock, self._times = clock, times
        self._carriers = carriers or {}
        self._watched: dict[str, _Watched] = {}
        self._checked_ns = clock.monotonic_ns()

    def record_start(self, node: str, process_id: int) -> None:
        """Record the process of a node; it is judged from its first report on."""
        self._watched[node] = _Watched(process_id)

    def record_report(self, node: str, process_id: int, *, is_stopping: bool) -> list[Finding]:
        """Record node/health; return the end of a silence if that was reported.

        Reports of another process id, such as that of an ended process of the node, are ignored.
        """
        watched = self._watched.get(node)
        if watched is None or watched.process_id != process_id:
            return []
        now, last = self._clock.monotonic_ns(), watched.last_ns
        # A stopping process has sent its last report, so its silence is not judged.
        self._watched[node] = row = _Watched(process_id)
        row.last_ns = None if is_stopping else now
        row.looked_ns = now
        self._look(row, now)
        if watched.reported is None or last is None:
            return []
        silence_s = (now - last) * 1e-9
        return [Finding(node, "back", silence_s, f"{node} reports again after {silence_s:.1f} s")]

    def forget(self, nodes: Iterable[str]) -> None:
        """Forget nodes whose processes have ended."""
        for node in nodes:
            self._watched.pop(node, None)

    def check(self) -> list[Finding]:
        """Return the findings since the last call: each silence once, and again if it turns out to be a hang."""
        now = self._clock.monotonic_ns()
        elapsed_s = (now - self._checked_ns) * 1e-9
        # While the launcher or the whole machine stood still, no report could be received, so that time does not count.
        awake_s = min(elapsed_s, LOOK_S)
        self._checked_ns = now
        hangs = []
        if elapsed_s >= SILENCE_S and self._watched:
            subject = "the launcher, or the whole machine,"
            text = f"{subject} stood still for {elapsed_s:.1f} s: silence of the nodes in that time does not count"
            hangs.append(Finding("", "paused", elapsed_s, text))
        for node, watched in self._watched.items():
            if watched.last_ns is not None:
                if self._can_be_heard(node):
                    watched.silence_s += awake_s
                else:
                    watched.silence_s = 0.0
                if now - watched.looked_ns >= LOOK_S * 1e9:
                    self._look(watched, now)
                is_recorder = name_of(node) == name_of(RECORDER)
                kind = _judged(watched, RECORDER_BUSY_S if is_recorder else SILENCE_S)
                if kind is not None and kind != watched.reported and (kind == "hung" or watched.reported is None):
                    watched.reported = kind
                    silence_s = (now - watched.last_ns) * 1e-9
                    carrier = self._carriers.get(node, "")
                    hangs.append(Finding(node, kind, silence_s, _sentence(node, kind, silence_s, watched, carrier)))
        return hangs

    def _can_be_heard(self, node: str) -> bool:
        """Return whether the process that passes on the reports of a node, if any, runs and has reported itself."""
        carrier = self._carriers.get(node)
        if carrier is None:
            return True
        row = self._watched.get(carrier)
        return row is not None and row.last_ns is not None

    def _look(self, watched: _Watched, now_ns: int) -> None:
        """Take a sample; add the time since the last one to the busy time, or reset it if the process was idle."""
        before, elapsed_s = watched.sample, (now_ns - watched.looked_ns) * 1e-9
        watched.looked_ns = now_ns
        try:
            watched.sample = sample = self._times.read(watched.process_id)
        except (OSError, ValueError) as error:
            watched.sample, watched.why_not, watched.busy_s = None, str(error), 0.0
            return
        if before is None or elapsed_s <= 0.0:
            return
        is_busy = sample.state not in _STOPPED and sample.cpu_s - before.cpu_s >= BUSY_SHARE * elapsed_s
        watched.busy_s = watched.busy_s + min(elapsed_s, LOOK_S) if is_busy else 0.0


def _judged(watched: _Watched, longest_busy_s: float) -> Kind | None:
    if watched.silence_s < SILENCE_S:
        return None
    if watched.sample is None:
        return "unknown"
    if watched.sample.state in _STOPPED:
        return "stopped"
    if watched.busy_s == 0.0:
        return "starved"
    # The limit counts busy time, so a process that did not get a processor has the same time to catch up as any other.
    return "hung" if watched.busy_s >= longest_busy_s else None


def _sentence(node: str, kind: Kind, silence_s: float, watched: _Watched, carrier: str) -> str:
    silent = f"{node} has not reported for {silence_s:.1f} s"
    if kind == "hung":
        return f"{silent} and has taken a processor for the last {watched.busy_s:.1f} s: it hangs and is killed"
    if kind == "stopped":
        return f"{silent}: it is stopped, by a signal or a debugger, and is left alone"
    if kind == "starved" and carrier:
        way = f"its reports pass {carrier}, where they may be held up or lost"
        return f"{silent}: {way}; it does not hang, and is left alone"
    if kind == "starved":
        return f"{silent} and used little or no processor time: it is idle, not hung, and is left alone"
    return f"{silent}; whether it hangs cannot be decided here ({watched.why_not}), and it is left alone"

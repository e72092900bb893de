"""A recorded trial: the tables that its task judges, and the evidence of disturbances."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.recording import ColumnTable, RecordedMessage, Recording, Timeline, columns_of, quantity
from telenano.wire import RecordingError
from telenano_lab.experiments.disturbances import Evidence, Hold, Passage
from telenano_lab.experiments.extend import TrialData
from telenano_lab.experiments.types import particle_table

_TABLES = ("afm/state", "haptic/state", "law/status")
_PARTICLES = "afm/particles"
_WANTED = (*_TABLES, "link/fates", "session/event", "node/health", _PARTICLES)
_SAMPLES = {"forward": "teleop/forward", "backward": "teleop/backward"}
_MASTER = "controller@master"
# Margin before and after the trial, for the causes and the reports of events [ns].
_MARGIN_NS = 1_000_000_000


class RecordedTrial:
    """The last run of the operator's force profile in a recording.

    Args:
        path: The recording of one trial.

    Raises:
        RecordingError: The file cannot be read, or no force profile ran in it.
    """

    def __init__(self, path: Path) -> None:
        self._recording = Recording(path)
        self._timeline = Timeline(self._recording)
        hand = _Rows(self._recording.messages(["haptic/state"]), self._timeline)
        self.start_ns, self.end_ns = _last_run(path, hand)
        self.duration_s = 1e-9 * (self.end_ns - self.start_ns)
        messages_of: dict[str, list[RecordedMessage]] = {topic: [] for topic in _WANTED}
        for message in self._recording.messages(_WANTED, self.start_ns - _MARGIN_NS, self.end_ns + _MARGIN_NS):
            if message.channel.topic in messages_of and "@" not in message.channel_topic:
                messages_of[message.channel.topic].append(message)
        status = [message for message in messages_of.pop("law/status") if message.src == _MASTER]
        self._rows = {
            "haptic/state": hand,
            "afm/state": _Rows(messages_of.pop("afm/state"), self._timeline),
            "law/status": _Rows(status, self._timeline),
        }
        self._messages = messages_of

    def data(self, most_s: float, answers: Iterable[Mapping[str, Any]] = ()) -> TrialData:
        """Return the tables of the trial from its beginning to its end, but at most for most_s [s]."""
        until_s = min(most_s, self.duration_s)
        afm, haptic, status = (self._table(topic, until_s) for topic in _TABLES)
        return TrialData(afm, haptic, status, tuple(answers), self._particles(until_s))

    def evidence(self, duration_s: float, quiet_s: float = 0.0) -> Evidence:
        """Return the evidence of disturbances of the trial.

        Args:
            duration_s: Planned duration of the trial [s].
            quiet_s: The longest time for which the dead band may suppress signals [s]; 0 without one.
        """
        events: list[tuple[float, str, Any]] = [
            (self._time_s(message), message.src, message.decode()) for message in self._of("session/event")
        ]
        faults = [f"{src}: {event.text}" for time_s, src, event in events if self._is_fault(time_s, event)]
        holds = [
            Hold(time_s, src, str(event.data.get("reason", event.text)))
            for time_s, src, event in events
            if event.kind == "mode" and event.level != "info"
        ]
        return Evidence(
            duration_s=min(duration_s, self.duration_s),
            hand_s=self._steps("haptic/state"),
            tip_s=self._steps("afm/state"),
            forward=self._passage("forward"),
            backward=self._passage("backward"),
            holds=holds,
            estops=self._estops(),
            restarted=self._restarted(),
            faults=faults,
            missing=self._missing(),
            quiet_s=quiet_s,
        )

    def _particles(self, until_s: float) -> ColumnTable | None:
        """Return the true places of the first particle, including reports just before the trial; None without any."""
        rows: list[tuple[float, float, float]] = []
        for message in self._of(_PARTICLES):
            report: Any = message.decode()
            places, time_s = np.asarray(report.places_m.to_numpy(), dtype=np.float64), self._time_s(message)
            if places.size and time_s <= until_s:
                rows.append((time_s, float(places[0, 0]), float(places[0, 1])))
        if not rows:
            return None
        return particle_table(*np.array(rows).T)

    def _of(self, topic: str) -> list[RecordedMessage]:
        return self._messages[topic]

    def _time_s(self, message: RecordedMessage) -> float:
        return 1e-9 * float(self._timeline.time_ns(message) - self.start_ns)

    def _is_fault(self, time_s: float, event: Any) -> bool:
        return event.level == "error" and 0.0 <= time_s <= self.duration_s

    def _steps(self, topic: str) -> npt.NDArray[np.float64]:
        times_s, steps_s = self._inside(topic, "step_s")
        return np.column_stack((times_s, steps_s.astype(np.float64)))

    def _inside(self, topic: str, name: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[Any]]:
        """Return the times [s] of the messages within the trial, and one of their fields."""
        rows = self._rows[topic]
        times_s = rows.times_s(self.start_ns)
        inside = (times_s >= 0.0) & (times_s <= self.duration_s)
        return times_s[inside], rows.column(name)[inside] if times_s.size else np.empty(0)

    def _missing(self) -> list[str]:
        """Return sentences on missing states of the devices, by gaps in their sequence numbers."""
        missing = []
        for topic in ("haptic/state", "afm/state"):
            _, numbers = self._inside(topic, "seq")
            lost = int(np.maximum(np.diff(np.sort(numbers)) - 1, 0).sum())
            if lost:
                missing.append(f"{lost} messages of {topic} are missing")
        return missing

    def _passage(self, way: str) -> Passage:
        arrived: list[int] = []
        released: list[int] = []
        for message in self._of("link/fates"):
            # The link reports every message; validating all reports would take longer than the trial.
            report = message.fields()
            if report["direction"] != way:
                continue
            for fate in report["fates"]:
                if fate["topic"] == _SAMPLES[way] and not fate["is_duplicate"]:
                    arrived.append(fate["arrived_ns"])
                    if not fate["dropped"] and not fate["corrupted"]:
                        released.append(fate["arrived_ns"] + fate["delay_ns"])
        return Passage(_seconds(arrived, self.start_ns), _seconds(released, self.start_ns))

    def _estops(self) -> list[tuple[str, float]]:
        stops = []
        for topic, field, stopped in (("haptic/state", "estop", True), ("afm/state", "mode", "estop")):
            times_s, values = self._inside(topic, field)
            if len(when := times_s[values == stopped]):
                stops.append((self._rows[topic].src, float(when[0])))
        return stops

    def _restarted(self) -> list[str]:
        newest: dict[str, Any] = {}
        nodes = set()
        for message in self._of("node/health"):
            health: Any = message.decode()
            before = newest.get(message.src)
            if before is not None and (health.pid != before.pid or health.t_ns - before.t_ns > 3 * 10**9):
                nodes.add(message.src)
            newest[message.src] = health
        return sorted(nodes)

    def _table(self, topic: str, most_s: float) -> ColumnTable:
        rows = self._rows[topic]
        times_s = rows.times_s(self.start_ns)
        inside = np.flatnonzero((times_s >= 0.0) & (times_s <= most_s))
        order = inside[np.argsort(times_s[inside], kind="stable")]
        columns: dict[str, npt.NDArray[Any]] = {"time_s": times_s[order]}
        for name in rows.columns:
            if name not in ("log_ns", "publish_ns"):
                columns[name] = rows.column(name)[order]
        facts = {name: quantity(topic, name) for name in columns}
        units = {name: fact.unit for name, fact in facts.items()} | {"time_s": "s"}
        texts = {name: fact.description for name, fact in facts.items()} | {"time_s": "Time since the trial began"}
        return ColumnTable(topic, columns, units, texts)


class _Rows:
    """Messages of one source as columns."""

    def __init__(self, messages: Iterable[RecordedMessage], timeline: Timeline) -> None:
        message_list = list(messages)
        self.src = message_list[0].src if message_list else ""
        self.columns = columns_of(message_list)
        stamps = np.array([(message.publish_ns, message.log_ns) for message in message_list], dtype=np.int64)
        self.times_ns = timeline.times_ns(self.src, *stamps.reshape(-1, 2).T)

    def times_s(self, start_ns: int) -> npt.NDArray[np.float64]:
        """Return the sending times relative to start_ns [s], shape (n,)."""
        return 1e-9 * (self.times_ns - start_ns)

    def column(self, name: str) -> npt.NDArray[Any]:
        """Return a field of the messages, shape (n,)."""
        return _column(self.columns[name].uniform())


def _seconds(stamps_ns: list[int], start_ns: int) -> npt.NDArray[np.float64]:
    """Return time stamps as sorted times relative to start_ns [s]."""
    return np.array([1e-9 * (stamp_ns - start_ns) for stamp_ns in sorted(stamps_ns)], dtype=np.float64)


def _column(plain: list[Any]) -> npt.NDArray[Any]:
    kinds = {type(value) for value in plain if value is not None}
    if kinds <= {float, int} and kinds:
        return np.array([np.nan if value is None else value for value in plain], dtype=np.float64)
    if kinds == {bool} and None not in plain:
        return np.array(plain)
    column = np.empty(len(plain), dtype=object)
    column[:] = plain
    return column


def _last_run(path: Path, hand: _Rows) -> tuple[int, int]:
    """Return begin and end of the last run of the operator's force profile [ns]."""
    session_s = hand.column("session_s") if hand.columns else np.empty(0)
    runs = session_s >= 0.0
    before = np.concatenate(([-1.0], session_s[:-1]))
    begins = np.flatnonzero(runs & ((before < 0.0) | (session_s < before)))
    if not begins.size:
        raise RecordingError(f"{path}: no operator's force profile ran in it")
    begin = int(begins[-1])
    after = np.flatnonzero(~runs[begin:])
    last = begin + int(after[0]) - 1 if after.size else len(runs) - 1
    return int(hand.times_ns[begin]) - round(1e9 * float(session_s[begin])), int(hand.times_ns[last])

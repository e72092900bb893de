"""Recordings and running rigs for programs of your own: tables with session time and units.

    import telenano
    session = telenano.open("out/fig12/session.mcap")
    tip = session.table("afm/state")
    tip["time_s"], tip["tip_force_n.2"], tip.units["tip_force_n.2"]
    session.df("law/status", "controller@master")     # pandas, where it is installed

    soft = telenano.simulate(law="wave", round_trip_ms=40.0)
    soft["time_s"], soft["scaled_tip_force_n"], soft.verdict

    with telenano.live() as rig:
        print(rig.table("afm/state", duration_s=1.0)["tip_force_n.2"])

Vectors are those of the wire: in the frame of a site, z away from the sample, a column for each component.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from telenano.recording.column_table import Column, ColumnTable
from telenano.recording.messages import topic_of
from telenano.recording.multi_file import open_recordings
from telenano.recording.quantities import quantity
from telenano.recording.site_clock import Timeline
from telenano.recording.tables import TypedColumn, flat, row
from telenano.wire.errors import NoRecordingError, RecordingError, known_names
from telenano.wire.messages import Message

_LOOP = "haptic/state"


class Table(ColumnTable):
    """Columns of equal length, in the order of sending; each of shape (n,).

    `time_s` is the time of sending since the start of the operator's force profile [s], NaN where none ran, and `src`
    the publisher; the others are the fields of the message, `position_m.2` for a component. `units` and `descriptions`
    have an entry for each column. A value that a message lacks is NaN, or None among text and lists.
    """

    def __init__(self, topic: str, columns: Mapping[str, Column]) -> None:
        facts = {name: quantity(topic, name) for name in columns}
        units = {name: fact.unit for name, fact in facts.items()} | {"time_s": "s"}
        descriptions = {name: fact.description for name, fact in facts.items()}
        descriptions["time_s"] = "Time of sending since the start of the operator's force profile"
        super().__init__(topic, columns, units, descriptions)
        self.topic = topic

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame, with `topic` and `units` in its attrs; ConfigError where pandas is missing."""
        frame = super().to_pandas()
        frame.attrs.update(topic=self.topic)
        return frame


class RecordedSession:
    """A recording, or all parts of one, for reading; made by `open`."""

    def __init__(self, paths: Iterable[Path], *, same_session: bool = False) -> None:
        self._source = open_recordings(list(paths), same_session=same_session)

    def __repr__(self) -> str:
        length = "" if self.start_ns is None else ", with a session of the operator"
        return f"<RecordedSession {self._source.path}: {len(self.channels)} channels{length}>"

    @property
    def channels(self) -> dict[str, tuple[str, ...]]:
        """The publishers of each channel; `teleop/forward@slave` is what came out of the link there."""
        fields_of: dict[str, list[str]] = {}
        for channel in self._source.channels:
            fields_of.setdefault(channel.channel_topic, []).append(channel.src)
        return {name: tuple(sorted(sources)) for name, sources in sorted(fields_of.items())}

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Conditions, figures and verdict, as in `summary.json`; RecordingError when the force profile never ran."""
        summary: dict[str, Any] = self._session.summary(self._source)
        return summary

    @cached_property
    def start_ns(self) -> int | None:
        """When the operator's force profile last began, on the publishers' clock [ns]; None if it never ran."""
        try:
            return int(self._session.start_ns)
        except RecordingError:
            return None

    @cached_property
    def _session(self) -> Any:
        from telenano.analysis.report import Session

        return Session.of(self._source)

    @cached_property
    def _timeline(self) -> Timeline:
        return Timeline(self._source)

    def table(self, channel: str, src: str | None = None) -> Table:
        """Return the messages of a channel in the order of sending, on one clock.

        Args:
            channel: The topic, with the site of its reception after an `@` where it crossed the link.
            src: One of its publishers; `*` takes those of all, each row with its own in the column `src`. None is for
                a channel that has one publisher.

        Raises:
            RecordingError: There is no such channel or publisher; the message names those there are.
        """
        sources = self.channels.get(channel)
        if sources is None:
            raise RecordingError(
                f"{self._source.path}: has no channel {channel}; {known_names(channel, self.channels)}"
            )
        if src is None and len(sources) > 1:
            raise RecordingError(f"{channel}: has several publishers, give one of {', '.join(sources)}, or '*' for all")
        if src not in (None, "*", *sources):
            raise RecordingError(f"{channel}: {src} published nothing on it; {', '.join(sources)} did")
        sent: dict[str, list[Any]] = {}
        for message in self._source.messages([channel]):
            if src in (None, "*", message.src):
                sent.setdefault(message.src, []).append(message)
        rows: list[tuple[int, dict[str, Any]]] = []
        for publisher, messages in sent.items():
            stamps = np.array([message.publish_ns for message in messages], dtype=np.int64)
            rows += zip(self._timeline.times_ns(publisher, stamps).tolist(), map(row, messages), strict=True)
        return _table(topic_of(channel), rows, self.start_ns)

    def df(self, channel: str, src: str | None = None) -> Any:
        """Return `table` as a pandas DataFrame."""
        return self.table(channel, src).to_pandas()


class LiveRig:
    """A rig that is running, for reading; made by `live`."""

    def __init__(self, observer: Any) -> None:
        self._observer = observer

    def __repr__(self) -> str:
        return f"<LiveRig: {', '.join(sorted(self._observer.subscribers))}>"

    def messages(self, duration_s: float | None = None) -> Iterator[tuple[str, Message]]:
        """Yield channel and message as they come, for a time [s], None for no end."""
        for observed in self._observer.listen(duration_s):
            yield observed.name, observed.received.message

    def table(self, channel: str, src: str | None = None, *, duration_s: float) -> Table:
        """Return what is received on a channel within a time [s]; `time_s` is that of the hand's force profile."""
        rows: list[tuple[int, dict[str, Any]]] = []
        start_ns: int | None = None
        for name, message in self.messages(duration_s):
            session_s = getattr(message, "session_s", -1.0)
            if name == _LOOP and session_s >= 0.0:
                start_ns = message.t_ns - round(session_s * 1e9)
            if name == channel and src in (None, message.src):
                rows.append((message.t_ns, flat(msgspec.structs.asdict(message))))
        return _table(topic_of(channel), rows, start_ns)


def open(path: str | os.PathLike[str], *further: str | os.PathLike[str], same_session: bool = False) -> RecordedSession:
    """Open a recording, or the files of one session, each once; of a folder the one recording that is in it.

    Args:
        path: The recording.
        further: Further files of the same session: parts of the recording, or that of the other site.
        same_session: Whether files are joined of which it is not recorded that they are of one session.

    Raises:
        RecordingError: A file cannot be read, a folder has not just one recording, or two files are not of one session;
            the message names them.
    """
    return RecordedSession(map(_recording_at, map(Path, (path, *further))), same_session=same_session)


def _recording_at(path: Path) -> Path:
    paths = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if len(paths) != 1:
        names = f" of {', '.join(each.name for each in paths)}" if paths else ""
        raise NoRecordingError(f"{path}: is a folder with {len(paths)} recordings (.mcap); give the file{names}")
    return paths[0]


def check_law(name: str) -> dict[str, list[str]]:
    """Try the rules that the rig relies on with a law; return each rule with what breaks it, empty where nothing does.

    This does the same as `telenano law check`.

    Raises:
        ConfigError: There is no such law, or the law of a package cannot be used; the message names the laws there are,
            or the reason.
    """
    from telenano.laws.law_rules import broken_rules

    return broken_rules(name)


@contextmanager
def live(site_file: str | os.PathLike[str] | None = None) -> Iterator[LiveRig]:
    """Connect to a running rig, by the packaged site file of one machine or one of your own.

    Raises:
        ConfigError: The site file is wrong, or this machine lacks a key; the message names what is wrong.
        RigError: No rig of the site file runs.
    """
    from telenano.runtime.wiring.observer import Observer
    from telenano.settings.included import DEFAULT_SITE_FILE

    path = Path(site_file) if site_file is not None else DEFAULT_SITE_FILE
    with closing(Observer.of_rig(path)) as observer:
        yield LiveRig(observer)


def _table(topic: str, rows: list[tuple[int, dict[str, Any]]], start_ns: int | None) -> Table:
    rows.sort(key=lambda sent: sent[0])
    sent_ns = np.array([at_ns for at_ns, _ in rows], dtype=np.int64)
    time_s = (sent_ns - start_ns) * 1e-9 if start_ns is not None else np.full(sent_ns.size, np.nan)
    columns: dict[str, Column] = {"time_s": np.asarray(time_s, dtype=np.float64)}
    for name in dict.fromkeys(name for _, values in rows for name in values):
        columns[name] = _column(TypedColumn.of([values.get(name) for _, values in rows]).uniform())
    return Table(topic, columns)


def _column(values: list[Any]) -> Column:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {float, int} and kinds and (float in kinds or None in values):
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if kinds in ({int}, {bool}) and None not in values:
        return np.array(values)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column

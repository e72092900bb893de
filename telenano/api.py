"""Recordings and running rigs for programs of your own: tables with session time and units.

    import telenano
    session = telenano.open("out/fig12/session.mcap")
    tip = session.table("afm/state")
    tip["time_s"], tip["tip_force_n.2"], tip.units["tip_force_n.2"]
    session.df("law/status", "controller@master")     # pandas, where it is installed

    soft = telenano.simulate(law="wave", round_trip_ms=40.0)
    for each in (session, soft):                      # both are a telenano.Session
        each.conditions.round_trip_ms, each.verdict, each.reason, each["time_s"], each["scaled_tip_force_n"]

    with telenano.live() as rig:
        print(rig.table("afm/state", duration_s=1.0)["tip_force_n.2"])

Vectors have the form of the wire: in the frame of a site, z away from the sample, one column for each component.
"""

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, fields
from functools import cached_property
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np

from telenano.analysis.fig12 import SessionSeries
from telenano.analysis.findings import Kind
from telenano.analysis.holds import Fact, Hold
from telenano.analysis.kept_summary import KeptSummary
from telenano.analysis.session import Conditions, Session
from telenano.files.optional_modules import required_module
from telenano.recording.column_table import Column, ColumnTable
from telenano.recording.messages import topic_of
from telenano.recording.multi_file import RecordingSource, open_recordings
from telenano.recording.quantities import quantity
from telenano.recording.site_clock import Timeline
from telenano.recording.tables import TypedColumn, flat, row
from telenano.signals import in_processes
from telenano.wire.errors import ConfigError, NoRecordingError, RecordingError, TelenanoError, known_names
from telenano.wire.messages import Message

if TYPE_CHECKING:
    import pandas

    from telenano.analysis.felt_stiffness import FeltSession
    from telenano.analysis.recorded_session import Session as ReadSession

_LOOP = "haptic/state"
# The columns of a table of recordings that do not depend on their content.
_CONDITIONS = tuple(field.name for field in fields(Conditions) if field.name != "parameters")
_HOLD_NUMBERS = tuple(name for name in Hold._fields if name not in ("verdict", "reason", "facts"))
_FIRST = (
    *("file", *_CONDITIONS, "measured_round_trip_ms", "session_verdict", "session_reason", "hold"),
    *Hold._fields,
)
_NEEDS_PANDAS = "a table of sessions as data of pandas: pandas is not installed"
# Width of the progress bar in characters.
_BAR = 30


class Table(ColumnTable):
    """Columns of equal length in order of send time, each of shape (n,).

    `time_s` is the send time since the start of the operator's force profile [s], NaN if none ran, and `src` the
    publisher; the others are the fields of the message, `position_m.2` for a component. `units` and `descriptions` have
    an entry for each column. A missing value is NaN, or None in a column of texts or lists.
    """

    def __init__(self, topic: str, columns: Mapping[str, Column]) -> None:
        facts = {name: quantity(topic, name) for name in columns}
        units = {name: fact.unit for name, fact in facts.items()} | {"time_s": "s"}
        descriptions = {name: fact.description for name, fact in facts.items()}
        descriptions["time_s"] = "Time of sending since the start of the operator's force profile"
        super().__init__(topic, columns, units, descriptions)
        self.topic = topic

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a pandas DataFrame, with `topic` and `units` in its attrs; raise ConfigError without pandas."""
        frame = super().to_pandas()
        frame.attrs.update(topic=self.topic)
        return frame


class JudgedRecording(NamedTuple):
    """Results on a recording: its summary with the verdict, its conditions, and the start of the force profile [ns]."""

    summary: dict[str, Any]
    conditions: Conditions
    start_ns: int


class RecordedSession(Session):
    """A recorded session, in one file or in parts; returned by `open`.

    If the operator's force profile never ran, only the tables can be read; everything else raises RecordingError.
    """

    def __init__(self, paths: Iterable[Path], *, same_session: bool = False) -> None:
        self._paths = list(paths)
        # Made before the files are opened, because it reads their state.
        self._kept = KeptSummary(self._paths) if self._paths else None
        self._same_session = same_session
        self._source = open_recordings(self._paths, same_session=same_session)
        # The files are opened again later, perhaps from another working folder.
        self._paths = [path.absolute() for path in self._paths]

    def __reduce__(self) -> tuple[Any, ...]:
        # Another process opens the files again; what is known of them goes with it.
        known = {"_judged": self._judged} if self.is_judged else {}
        return RecordedSession._opened, (self._paths, self._same_session, known)

    @classmethod
    def _opened(cls, paths: list[Path], same_session: bool, known: dict[str, Any]) -> "RecordedSession":
        session = cls(paths, same_session=same_session)
        session.__dict__.update(known)
        return session

    def __repr__(self) -> str:
        length = "" if self.start_ns is None else ", with a session of the operator"
        return f"<RecordedSession {self._source.path}: {len(self.channels)} channels{length}>"

    @property
    def file(self) -> str:
        """The path of the recording, or of the first of its files."""
        return str(self._source.path)

    @cached_property
    def course(self) -> ColumnTable:
        """All columns of the session as a table; RecordingError if the force profile never ran."""
        from telenano.analysis.recorded_course import course_of

        return course_of(self._session)

    @property
    def conditions(self) -> Conditions:
        """The settings of the session, including a delay that was set before it began."""
        return self._judged.conditions

    @property
    def measured_round_trip_ms(self) -> float | None:
        """Median of the delay that the link added there and back [ms]; None if it reported none."""
        trip_ms: float | None = self.summary["link_round_trip_ms"]
        return trip_ms

    @cached_property
    def holds(self) -> list[Hold]:
        """The holds of the hand, each with its verdict."""
        return [
            Hold(**{**hold, "facts": tuple(Fact(**fact) for fact in hold["facts"])}) for hold in self.summary["holds"]
        ]

    @property
    def verdict(self) -> Kind:
        """Verdict of the session: that of its worst hold, or `guarded` if the instrument's guard ended it."""
        kind: Kind = self.summary["verdict"]
        return kind

    @property
    def reason(self) -> str:
        """The verdict in words; a guard that acted comes first, with its time and limit."""
        return str(self.summary["reason"])

    @cached_property
    def felt_stiffness(self) -> "FeltSession":
        """The stiffness that the hand felt, compared with the actual one, or the reason why it is unknown."""
        return self._session.felt(self._analysed)

    @property
    def channels(self) -> dict[str, tuple[str, ...]]:
        """The publishers of each channel; `teleop/forward@slave` is the channel behind the link at the slave's site."""
        fields_of: dict[str, list[str]] = {}
        for channel in self._source.channels:
            fields_of.setdefault(channel.channel_topic, []).append(channel.src)
        return {name: tuple(sorted(sources)) for name, sources in sorted(fields_of.items())}

    @property
    def summary(self) -> dict[str, Any]:
        """Conditions, figures and verdict, as in `summary.json`; RecordingError if the force profile never ran."""
        return self._judged.summary

    @cached_property
    def start_ns(self) -> int | None:
        """Last start of the operator's force profile, by the publishers' clock [ns]; None if it never ran."""
        try:
            return self._judged.start_ns if "_judged" in self.__dict__ else int(self._session.start_ns)
        except RecordingError:
            return None

    @property
    def is_judged(self) -> bool:
        """Whether the verdict is already known, in this object or in a file beside the recording."""
        if "_judged" not in self.__dict__ and (kept := self._read_kept()) is not None:
            self.__dict__["_judged"] = kept
        return "_judged" in self.__dict__

    @cached_property
    def _judged(self) -> JudgedRecording:
        if (kept := self._read_kept()) is not None:
            return kept
        from telenano.analysis.recorded_course import conditions_of
        from telenano.analysis.session_judge import summary_of

        summary = summary_of(self._session, self._analysed)
        judged = JudgedRecording(summary, conditions_of(self._analysed, self._session), self._session.start_ns)
        if self._kept is not None:
            facts = {"path": str(self._source.path), "conditions": asdict(judged.conditions)}
            self._kept.write({**facts, "summary": judged.summary, "start_ns": judged.start_ns})
        return judged

    def _read_kept(self) -> JudgedRecording | None:
        found = None if self._kept is None else self._kept.read()
        if found is None:
            return None
        try:
            summary, stated = found["summary"], found["conditions"]
            before, now = found["path"], str(self._source.path)
            if before != now:
                # The recording was moved: replace its path in the one known place, and give up if others have it.
                summary["recording"]["file"] = now
                if before in json.dumps(summary):
                    return None
            return JudgedRecording(
                summary, Conditions(**{**stated, "changed": tuple(stated["changed"])}), int(found["start_ns"])
            )
        except (KeyError, TypeError, ValueError):
            return None

    def _drawn(self) -> tuple[SessionSeries, str]:
        from telenano.analysis.report import figure_title

        gaps_s = () if self.summary["recording"]["complete"] else self._session.gaps_s()
        return self._session.series(gaps_s), figure_title(self._session, self.summary)

    @cached_property
    def _session(self) -> "ReadSession":
        from telenano.analysis.recorded_session import Session as ReadSession

        return ReadSession.of(self._analysed)

    @cached_property
    def _analysed(self) -> RecordingSource:
        # A second reader, so that the caller's earlier reads do not add to its count of unreadable messages.
        return open_recordings(self._paths)

    @cached_property
    def _timeline(self) -> Timeline:
        return Timeline(self._source)

    def table(self, channel: str, src: str | None = None) -> Table:
        """Return the messages of a channel in order of send time, by one clock.

        Args:
            channel: The topic; with `@` and the site of reception if it crossed the link.
            src: One of its publishers, or `*` for all, which the column `src` names for each row. None suffices for a
                channel with one publisher.

        Raises:
            RecordingError: There is no such channel or publisher, or `src` is missing; the message lists the names.
        """
        sources = self.channels.get(channel)
        if sources is None:
            raise RecordingError(
                f"{self._source.path}: has no channel {channel}; {known_names(str(channel), self.channels)}"
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
            stamps, heard = np.array([(each.publish_ns, each.log_ns) for each in messages], dtype=np.int64).T
            rows += zip(self._timeline.times_ns(publisher, stamps, heard).tolist(), map(row, messages), strict=True)
        return _table(topic_of(channel), rows, self.start_ns)


class LiveRig:
    """A running rig, for reading; returned by `live`."""

    def __init__(self, observer: Any) -> None:
        self._observer = observer

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("a LiveRig is a connection of this process: call telenano.live() in the other one")

    def __repr__(self) -> str:
        return f"<LiveRig: {', '.join(sorted(self._observer.subscribers))}>"

    def messages(self, duration_s: float | None = None) -> Iterator[tuple[str, Message]]:
        """Yield channel and message of each received message, for `duration_s` [s] or, if None, without end."""
        for observed in self._observer.listen(duration_s):
            yield observed.name, observed.received.message

    def table(self, channel: str, src: str | None = None, *, duration_s: float) -> Table:
        """Return the messages received on a channel within `duration_s` [s]; `time_s` counts from the force profile."""
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
    """Open a recording, or several files of one session; a folder stands for the only recording in it.

    Args:
        path: The recording.
        further: Further files of the same session: parts of the recording, or that of the other site.
        same_session: Whether to join files that do not state whether they belong to one session.

    Raises:
        RecordingError: A file cannot be read, a folder does not have exactly one recording, or two files are not of one
            session; the message names them.
    """
    for each in (path, *further):
        _check_path(each)
    return RecordedSession(map(_recording_at, map(Path, (path, *further))), same_session=same_session)


def _check_path(path: object) -> None:
    if isinstance(path, (str, os.PathLike)):
        return
    many = "; telenano.open_all takes many" if isinstance(path, Iterable) and not hasattr(path, "read") else ""
    raise TypeError(
        f"a recording is named by its path, such as 'out/fig12/session.mcap', and not by a value of the type"
        f" {type(path).__name__}{many}"
    )


def _recording_at(path: Path) -> Path:
    if not path.exists():
        from telenano.settings.included import known_scenarios

        if has_magic(str(path)):
            raise NoRecordingError(f"{path}: is a pattern of names, which telenano.open_all takes; open takes one path")
        if str(path) in known_scenarios():
            raise NoRecordingError(
                f"{path}: no recording, but a scenario has this name: telenano.simulate({str(path)!r}) runs it"
            )
    paths = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if len(paths) != 1:
        names = f" of {', '.join(each.name for each in paths)}" if paths else ""
        raise NoRecordingError(f"{path}: is a folder with {len(paths)} recordings (.mcap); give the file{names}")
    return paths[0]


def open_all(
    recordings: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    jobs: int | None = None,
    progress: bool = True,
) -> "pandas.DataFrame":
    """Return a table of many recordings with one row for each hold: conditions, verdict of the session, and the hold.

    Results are saved beside each recording, so that a second call takes milliseconds for each, and an interrupted call
    can be continued. A session without a hold has one row; so has a recording that cannot be judged, with the error in
    `session_reason`.

    Args:
        recordings: A pattern of paths, such as `out/**/session.mcap`, in which a folder stands for the only recording
            in it; or paths of files and folders.
        jobs: The number of recordings that are judged at a time; None for the number of processors.
        progress: Whether to show a progress bar on a terminal or in a notebook.

    Raises:
        NoRecordingError: No recording matches; the message names the pattern.
        ConfigError: pandas is not installed; the message says how to install it.
    """
    required_module("pandas", _NEEDS_PANDAS, "export")
    paths = _recordings_at(recordings)
    rows_of: dict[Path, list[dict[str, Any]]] = {}
    for path in paths:
        if (rows := _rows(path, kept_only=True)) is not None:
            rows_of[path] = rows
    new = [path for path in paths if path not in rows_of]
    show_progress("recordings judged", 0, len(new), progress)
    with closing(in_processes(jobs, _rows, new)) as judged:
        for number, (place, rows) in enumerate(judged, start=1):
            rows_of[new[place]] = rows or []
            show_progress("recordings judged", number, len(new), progress)
    return frame_of([row for path in paths for row in rows_of[path]])


def frame_of(rows: list[dict[str, Any]]) -> "pandas.DataFrame":
    """Return the rows of sessions as a table of pandas; ConfigError where that is not installed."""
    frames = required_module("pandas", _NEEDS_PANDAS, "export")
    names = dict.fromkeys(name for row in rows for name in row)
    # Columns that only some holds or laws have follow those that every session has.
    frame = frames.DataFrame(rows, columns=[*dict.fromkeys([*_FIRST, *names])])
    return frame.astype({name: float for name in _HOLD_NUMBERS})


def _recordings_at(recordings: str | os.PathLike[str] | Iterable[str | os.PathLike[str]]) -> list[Path]:
    if isinstance(recordings, (str, os.PathLike)):
        names = sorted(glob(os.fspath(recordings), recursive=True))  # noqa: PTH207 - that of a path takes no absolute pattern
        # Skip matches that are no recording, such as figures, and folders without one.
        paths = [
            path for path in map(Path, names) if path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap")))
        ]
        if not paths:
            raise NoRecordingError(f"{recordings}: no recording (.mcap) and no folder with one has such a name")
    else:
        if not isinstance(recordings, Iterable):
            _check_path(recordings)
        recordings = list(recordings)
        for each in recordings:
            _check_path(each)
        paths = [Path(each) for each in recordings]
    # A pattern may match a recording, its folder, and a link to it; each recording counts once.
    own: dict[str, Path] = {os.path.realpath(path): path for path in reversed(paths) if not path.is_dir()}
    for path in paths:
        inside = [os.path.realpath(each) for each in sorted(path.glob("*.mcap"))] if path.is_dir() else []
        if inside and not set(inside) <= set(own):
            own[inside[0] if len(inside) == 1 else os.path.realpath(path)] = path
        elif not inside and path.is_dir():
            own[os.path.realpath(path)] = path
    return sorted(own.values())


def _rows(path: Path, *, kept_only: bool = False) -> list[dict[str, Any]] | None:
    """Return the rows of a recording; None if `kept_only` is set and its results are not saved yet."""
    try:
        path = _recording_at(path)
        session = RecordedSession([path])
        if kept_only and not session.is_judged:
            return None
        return rows_of_session(session, str(path))
    except TelenanoError as error:
        return [{"file": str(path), "session_reason": str(error)}]


def rows_of_session(session: Session, file: str) -> list[dict[str, Any]]:
    """Return the rows of a session in a table of many, one for each hold, or one without a hold.

    Raises:
        RecordingError: It cannot be judged.
    """
    stated, holds = session.conditions, session.holds
    facts = {
        "file": file,
        **stated.row(),
        "measured_round_trip_ms": session.measured_round_trip_ms,
        "session_verdict": session.verdict,
        "session_reason": session.reason,
    }
    rows = [
        {**hold._asdict(), "hold": number, "facts": ", ".join(fact.kind for fact in hold.facts)}
        for number, hold in enumerate(holds)
    ]
    parameters = {(f"law.{name}" if name in _FIRST else name): value for name, value in stated.parameters.items()}
    return [{**facts, **row, **parameters} for row in rows or [{}]]


def show_progress(what: str, done: int, whole: int, is_wanted: bool) -> None:
    """Show how far a call is, in a notebook or on a terminal."""
    # Only a notebook and a terminal can return to the beginning of the line.
    if is_wanted and whole > 1 and (sys.stderr.isatty() or "ipykernel" in sys.modules):
        bar = "#" * (_BAR * done // whole)
        end = "\n" if done == whole else ""
        sys.stderr.write(f"\r{what}: [{bar:<{_BAR}}] {done} of {whole}{end}")
        sys.stderr.flush()


def check_law(name: str) -> dict[str, list[str]]:
    """Test a law against the rules on which the rig relies; return the violations of each rule, empty if it holds.

    This does the same as `telenano law check`.

    Raises:
        ConfigError: There is no such law, or the law of a package cannot be used; the message lists the laws or names
            the reason.
    """
    from telenano.lockstep.law_rules import broken_rules

    return broken_rules(name)


def curves(
    files: str | os.PathLike[str] | Iterable[str | os.PathLike[str]], model: str = "hertz", **shape: Any
) -> "pandas.DataFrame":
    """Fit a contact model to all force curves in files; return a pandas table with one row for each curve.

    This does the same as `telenano curve fit`, and needs telenano-lab.

    Args:
        files: A file, a folder, or several of them.
        model: hertz, sneddon, dmt or jkr.
        **shape: `radius_m` of the tip [m], or for sneddon `half_angle_rad` of the cone [rad]; `poisson`, Poisson's
            ratio of the sample (0.5); `thickness_m` of a sample on a hard substrate [m]; and `settings`, values that
            the files lack, as for `--set`.

    Raises:
        ConfigError: telenano-lab is not installed, there is no such file, or the shape of the tip is missing.
    """
    from telenano.settings.known_packages import KNOWN_PACKAGES
    from telenano.settings.plugins import load, refuse
    from telenano.wire.extras import how_to_add_package

    loaded = load("functions", only="curves")
    refuse(loaded, "curves")
    if "curves" not in loaded.found:
        package = KNOWN_PACKAGES["command curve fit"]
        raise ConfigError(f"telenano.curves is in the package {package}: {how_to_add_package(package)}")
    return loaded.found["curves"](files, model, **shape)


@contextmanager
def live(site_file: str | os.PathLike[str] | None = None) -> Iterator[LiveRig]:
    """Connect to a running rig, through your own site file or, without one, the packaged site file of one machine.

    Raises:
        ConfigError: The site file is invalid, or this machine lacks a key; the message names the fault.
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

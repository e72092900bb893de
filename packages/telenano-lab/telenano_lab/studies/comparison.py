"""Several recorded sessions side by side: their curves in one figure, their figures in one table."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from telenano.analysis import FigureOptions, Session, summary_of
from telenano.recording import demand_several, files_of, open_recordings, recordings_of
from telenano.settings import LoadedScenario
from telenano_lab.studies.figure_colours import LINES, ON_SCREEN
from telenano_lab.studies.published import PANELS, Published, nearest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The columns of a table, in this order: key of a summary, heading with its unit.
_COLUMNS = (
    ("verdict", "verdict"),
    ("law", "law"),
    ("link_round_trip_ms", "round trip of the link [ms]"),
    ("loop_round_trip_ms", "round trip of the loop [ms]"),
    ("link_profile", "link"),
    ("hold_ratio", "hold ratio"),
    ("contact_x_cm", "contact x_m [cm]"),
    ("release_force_nn", "force after release [nN]"),
    ("greatest_pull_nn", "greatest pull [nN]"),
    ("duration_s", "duration [s]"),
)


# A pattern such as `out/delay/*` gives these with the sessions that they were made from.
_RESULTS = (".csv", ".json", ".mat", ".parquet", ".pdf", ".png", ".svg")
# Each file of published points has a marker of its own.
_MARKERS = "osD^v"


class Compared(NamedTuple):
    """A session, what it is called beside the others, its summary, and the scenario that ran."""

    name: str
    session: Session
    summary: dict[str, Any]
    scenario: dict[str, Any]


def sessions_in(paths: Sequence[Path]) -> list[Path]:
    """Return the paths without the figures and tables that stand beside the folders of a sweep."""
    return [path for path in paths if not (path.is_file() and path.suffix in _RESULTS)]


def names_of(paths: Sequence[Path]) -> list[str]:
    """Return the shortest names by which paths differ: their last part, with as many before it as that takes."""
    parts = [_named(path).parts for path in paths]
    # An ending that all names share distinguishes nothing.
    while all(len(own) > 1 for own in parts) and len({own[-1] for own in parts}) == 1 and len(parts) > 1:
        if len(set(parts)) < len(parts):
            break
        parts = [own[:-1] for own in parts]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(own[-depth:]) for own in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def _named(path: Path) -> Path:
    """Return the part of a path that names a session: its folder where the file has the name that all have."""
    path = path.absolute()
    if path.suffix != ".mcap":
        return path
    return path.parent if path.stem == "session" else path.with_suffix("")


def compare(paths: Sequence[Path], *, same_session: bool = False) -> list[Compared]:
    """Read sessions, each once.

    Args:
        paths: A recording of each, or the folder with its files.
        same_session: Whether the files of a folder are joined that do not say that they are of one session.

    Raises:
        RecordingError: A file has no session, the files of a folder are not of one, or two paths are of one session.
        ConfigError: A folder has no recording.
    """
    opened = {path: open_recordings(recordings_of(path), same_session=same_session) for path in paths}
    once = demand_several([files_of(recording) for recording in opened.values()])
    opened = {path: recording for (path, recording), wanted in zip(opened.items(), once, strict=True) if wanted}
    rows = []
    for name, recording in zip(names_of(list(opened)), opened.values(), strict=True):
        session = Session.of(recording)
        scenario = LoadedScenario.attached(recording.path, recording.attachments).scenario.model_dump(mode="json")
        rows.append(Compared(name, session, summary_of(session, recording), scenario))
    return rows


def rows_of(sessions: Sequence[Compared]) -> list[dict[str, Any]]:
    """Return a row for each session: what distinguishes it first, then its figures, in the units of the headings."""
    changed = _differing([session.summary["parameters"] for session in sessions])
    rows = []
    for name, _, summary, _ in sessions:
        values = {heading: _value(summary[key]) for key, heading in _COLUMNS}
        values |= {key: summary["parameters"].get(key) for key in changed}
        age = summary["loop_age_ms"]
        rows.append({"session": name, **values, "loop age, median [ms]": None if age is None else age["p50"]})
    return rows


def _differing(documents: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = dict.fromkeys(key for document in documents for key in document)
    return [key for key in keys if len({str(document.get(key)) for document in documents}) > 1]


def _value(value: Any) -> Any:
    return " then ".join(value) if isinstance(value, list) else value


def beside(sessions: Sequence[Compared], published: Published) -> dict[str, Any]:
    """Return published points with the nearest point of each session, for JSON; None for a number that is not known."""
    rows = []
    for point in published.points:
        own = {name: dict(zip("xy", _known(nearest(session, point)), strict=True)) for name, session, *_ in sessions}
        x_error, y_error = _known((point.x_error, point.y_error))
        facts = {"x": point.x, "y": point.y, "x_error": x_error, "y_error": y_error, "note": point.note}
        rows.append({"curve": PANELS[point.panel], **facts, "nearest": own})
    return {"source": published.source, "points": rows}


def _known(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]


def compare_figure(
    sessions: Sequence[Compared], options: FigureOptions = ON_SCREEN, published: Sequence[Published] = ()
) -> "Figure":
    """Draw the sessions over one another: alpha_f F_s, x_m, and F_s against h; F_m of the first for reference.

    Published points are drawn beneath, with their errors.
    """
    from matplotlib.figure import Figure

    paper = options.style == "paper"
    with options.styled():
        figure = Figure(figsize=(FigureOptions.COLUMN_IN, 6.6) if paper else (7.6, 9.4), layout="constrained")
        panels = figure.subplots(3, 1)
        first = sessions[0].session.series()
        panels[0].plot(
            first.hand_time_s,
            first.hand_force_n,
            color=FigureOptions.REFERENCE,
            lw=2.4,
            zorder=0,
            label=f"$F_m$, {sessions[0].name}",
        )
        for number, (name, session, summary, _) in enumerate(sessions):
            colour, style = LINES[number % len(LINES)]
            look = {"color": colour, "ls": style, "lw": 1.0}
            _draw(panels, session, look, f"{name}: {summary['verdict'].replace('_', ' ')}")
        for number, point in enumerate(published, start=1):
            label = "published" if len(published) == 1 else f"published {number}"
            _draw_published(panels, point, {"marker": _MARKERS[number % len(_MARKERS)], "label": label})
        for panel, (x, y) in zip(panels, (("time (s)", r"$\alpha_f F_s$ (N)"), ("time (s)", r"$x_m$ (cm)"),
                                          ("tip-sample distance h (nm)", r"$F_s$ (nN)")), strict=True):  # fmt: skip
            panel.axhline(0.0, color="0.8", lw=0.8, zorder=-1)
            panel.set(xlabel=x, ylabel=y)
        options.lettered(list(panels))
        named: dict[str, Any] = {}
        for panel in panels:
            handles, labels = panel.get_legend_handles_labels()
            named |= dict(zip(labels, handles, strict=True))
        labels, handles = list(named), list(named.values())
        columns = 1 if paper or max(map(len, labels)) > 40 else 2
        figure.legend(handles, labels, loc="outside upper left", ncols=columns, fontsize=8, frameon=False)
    return figure


def _draw_published(panels: "Sequence[Axes]", published: Published, look: dict[str, Any]) -> None:
    curves = (("tip_force", "hand_force"), ("hand_position",), ("tip_path",))
    for names, panel in zip(curves, panels, strict=True):
        points = [point for name in names for point in published.of(name)]
        if points:
            x, y, x_error, y_error = zip(*(point[1:5] for point in points), strict=True)
            panel.errorbar(
                x, y, xerr=x_error, yerr=y_error, color="0.25", ls="", ms=4.0, mfc="white", capsize=2.0, lw=0.9, **look
            )


def _draw(panels: "Sequence[Axes]", session: Session, look: Mapping[str, Any], label: str) -> None:
    series = session.series()
    panels[0].plot(series.tip_time_s, series.force_scale * series.tip_force_n, label=label, **look)
    panels[1].plot(series.hand_time_s, 100.0 * series.hand_position_m, **look)
    path = series.tip_path()
    panels[2].plot(1e9 * path.separation_m, 1e9 * path.force_n, **look)

"""Compare recorded sessions: their curves in one figure, their results in one table."""

import math
import re
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis import FigureOptions, Session, summary_of
from telenano.recording import demand_several, files_of, open_recordings, recordings_of
from telenano.settings import LoadedScenario
from telenano.signals import in_processes
from telenano_lab.studies.figure_colours import LINES, ON_SCREEN, Look, looks
from telenano_lab.studies.published import PANELS, PublishedPoints, nearest
from telenano_lab.studies.repetitions import conditions_of, repetitions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

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


# A pattern such as `out/delay/*` also matches the results of sessions, which have these suffixes.
_RESULTS = (".csv", ".json", ".jsonl", ".mat", ".parquet", ".pdf", ".png", ".svg")
# Each file of published points has a marker of its own.
_MARKERS = "osD^v"
Floats = npt.NDArray[np.float64]
# The least and the greatest value of an ordinate; None leaves the choice to matplotlib.
Limits = tuple[float, float] | None
# Law and round trip are in the label anyway; these keys of a scenario would repeat them.
_SAID = re.compile(r"controller\.law|delay_node\..*delay_s|delay_node\.profile")
_AXES = (
    ("time (s)", r"$\alpha_f F_s$ (N)"),
    ("time (s)", r"$x_m$ (cm)"),
    ("distance h (nm)", r"$F_s$ (nN)"),
)
# The number of conditions that have their panels in one figure.
_ON_A_PAGE = 24
# Labels longer than this are listed in one column of a legend.
_WIDE = 48
# The margin beyond the curves at each end of an ordinate, as a share of its span.
_MARGIN = 0.08
# The least force that the panel of force against distance shows to its end, as a share of the greatest of its session,
# the least change that panels over time do, as a share of the span, and the margin beyond distances, as one of theirs.
_FELT = 0.02
_MARGIN_OF_DISTANCE = 0.25
# The place of F_m among the curves of a session.
_HAND_FORCE = 3
_REFERENCE: dict[str, Any] = {"color": FigureOptions.REFERENCE, "lw": 2.4, "zorder": 0}
_LEAVES = "diverges, beyond the axes"


class ComparedSession(NamedTuple):
    """A session, its name in the comparison, its summary, and its scenario."""

    name: str
    session: Session
    summary: dict[str, Any]
    scenario: dict[str, Any]


def sessions_in(paths: Sequence[Path]) -> list[Path]:
    """Return the paths without the figures and tables that stand beside the folders of a sweep."""
    return [path for path in paths if not (path.is_file() and path.suffix in _RESULTS)]


def names_of(paths: Sequence[Path]) -> list[str]:
    """Return the shortest names by which paths differ: their last parts, as many as are needed."""
    parts = [_named(path).parts for path in paths]
    # An ending that all paths share distinguishes nothing.
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
    """Return the part of a path that names a session: its folder, if the file has the usual name."""
    path = path.absolute()
    if path.suffix != ".mcap":
        return path
    return path.parent if path.stem == "session" else path.with_suffix("")


def compare(paths: Sequence[Path], *, same_session: bool = False, jobs: int | None = None) -> list[ComparedSession]:
    """Read sessions, each once.

    Args:
        paths: For each session its recording, or the folder with its files.
        same_session: Whether to join files of a folder that do not state that they are of one session.
        jobs: The number of sessions that are judged at a time; None for the number of processors.

    Raises:
        RecordingError: A file has no session, the files of a folder are not of one, or two paths are of one session.
        ConfigError: A folder has no recording.
    """
    opened = {path: open_recordings(recordings_of(path), same_session=same_session) for path in paths}
    once = demand_several([files_of(recording) for recording in opened.values()])
    opened = {path: recording for (path, recording), wanted in zip(opened.items(), once, strict=True) if wanted}
    named = [(name, path, same_session) for name, path in zip(names_of(list(opened)), opened, strict=True)]
    with closing(in_processes(jobs, _judged, named)) as done:
        rows = dict(done)
    return [rows[place] for place in sorted(rows)]


def _judged(named: tuple[str, Path, bool]) -> ComparedSession:
    name, path, same_session = named
    recording = open_recordings(recordings_of(path), same_session=same_session)
    session = Session.of(recording)
    scenario = LoadedScenario.attached(recording.path, recording.attachments).scenario.model_dump(mode="json")
    return ComparedSession(name, session, summary_of(session, recording), scenario)


def rows_of(sessions: Sequence[ComparedSession]) -> list[dict[str, Any]]:
    """Return a row for each session: distinguishing parameters and results, in the units of the headings."""
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


def beside(sessions: Sequence[ComparedSession], published: PublishedPoints) -> dict[str, Any]:
    """Return published points with the nearest point of each session, for JSON; unknown numbers are None."""
    rows = []
    for point in published.points:
        own = {name: dict(zip("xy", _known(nearest(session, point)), strict=True)) for name, session, *_ in sessions}
        x_error, y_error = _known((point.x_error, point.y_error))
        facts = {"x": point.x, "y": point.y, "x_error": x_error, "y_error": y_error, "note": point.note}
        rows.append({"curve": PANELS[point.panel], **facts, "nearest": own})
    return {"source": published.source, "points": rows}


def _known(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]


class Drawn(NamedTuple):
    """The curves of a session in a figure, x and y of each: alpha_f F_s and x_m over time, F_s against h, F_m."""

    diverged: bool
    curves: tuple[tuple[Floats, Floats], ...]

    @classmethod
    def of(cls, session: ComparedSession) -> "Drawn":
        """Read the curves of a session."""
        series = session.session.series()
        path = series.tip_path()
        return cls(
            session.summary["verdict"] == "diverged",
            (
                (series.tip_time_s, series.force_scale * series.tip_force_n),
                (series.hand_time_s, 100.0 * series.hand_position_m),
                (1e9 * path.separation_m, 1e9 * path.force_n),
                (series.hand_time_s, series.hand_force_n),
            ),
        )


class Condition(NamedTuple):
    """Sessions whose scenarios differ by their seeds only, and their label in a figure."""

    label: str
    sessions: tuple[ComparedSession, ...]

    @property
    def outcome(self) -> str:
        """The verdict of a single session, or the count of each verdict among several."""
        verdicts = Counter(session.summary["verdict"].replace("_", " ") for session in self.sessions)
        if len(self.sessions) == 1:
            return str(next(iter(verdicts)))
        return ", ".join(f"{count} of {len(self.sessions)} {name}" for name, count in verdicts.most_common())


def conditions_in(sessions: Sequence[ComparedSession]) -> list[Condition]:
    """Return the sessions grouped by their settings: a sweep with seeds gives each of its conditions once.

    If sessions differ by their seeds, the label of a condition has its law, its round trip and the further keys in
    which the conditions differ. Otherwise each session is a condition labelled with the name of its folder.
    """
    groups = [tuple(sessions[place] for place in places) for places in repetitions([s.scenario for s in sessions])]
    if all(len(group) == 1 for group in groups):
        return [Condition(group[0].name, group) for group in groups]
    labels = _labels([group[0] for group in groups])
    if len(set(labels)) < len(labels):
        labels = [f"{label} ({group[0].name})" for label, group in zip(labels, groups, strict=True)]
    return [Condition(label, group) for label, group in zip(labels, groups, strict=True)]


def _labels(firsts: Sequence[ComparedSession]) -> list[str]:
    """Return labels that distinguish sessions: law, round trip, and each further key with its value."""
    known = [
        {key: value for key, value in conditions_of(session.scenario).items() if not _SAID.fullmatch(key)}
        for session in firsts
    ]
    keys = _differing(known)
    short = {key: _tail(key, keys) for key in keys}
    labels = []
    for session, values in zip(firsts, known, strict=True):
        words = [str(_value(session.summary["law"])).replace("_", " ")]
        if (trip_ms := session.summary["link_round_trip_ms"]) is not None:
            words.append(f"{trip_ms:g} ms")
        words += [f"{short[key]} {_shown(values.get(key))}" for key in keys]
        labels.append(", ".join(words))
    return labels


def _tail(key: str, keys: Sequence[str]) -> str:
    """Return the shortest end of a dotted key that no other key has."""
    parts = key.split(".")
    ends = (".".join(parts[-count:]) for count in range(1, len(parts) + 1))
    return next(end for end in ends if sum(f".{other}".endswith(f".{end}") for other in keys) == 1)


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")


def compare_figures(
    sessions: Sequence[ComparedSession], options: FigureOptions = ON_SCREEN, published: Sequence[PublishedPoints] = ()
) -> "list[Figure]":
    """Draw sessions for comparison: each condition has a colour, and each of its sessions is a thin line.

    Each condition has a panel with alpha_f F_s and its F_m, all with the same axes, because a swing hides the curves
    that rest. With up to six conditions follow one panel with x_m of all, in which they differ by offsets, and for each
    condition a panel with F_s against h, which lies on one curve of the sample whatever the condition, over the path of
    the first. More than six conditions have their forces alone, in as many figures as needed. Times begin and end with
    what happens, distances where no force is left. A session that diverged is dotted and does not stretch the axes of
    the others; a cross marks where it leaves them. Published points are drawn beneath, with their errors.
    """
    from matplotlib.figure import Figure

    conditions = conditions_in(sessions)
    drawn = [[Drawn.of(session) for session in condition.sessions] for condition in conditions]
    everyone = [one for several in drawn for one in several]
    limits = [_limits([(one.curves[place][1], one.diverged) for one in everyone]) for place in range(len(_AXES))]
    paper = options.style == "paper"
    if len(conditions) > len(LINES):
        columns, width, height = (2, FigureOptions.COLUMN_IN, 1.8) if paper else (3, 10.0, 1.8)
    else:
        columns, width, height = (2, FigureOptions.COLUMN_IN, 2.0) if paper else (3, 9.0, 2.6)
    columns = min(len(conditions), columns)
    figures = []
    with options.styled():
        for first in range(0, len(conditions), _ON_A_PAGE):
            own = slice(first, first + _ON_A_PAGE)
            shown = conditions[own]
            rows = math.ceil(len(shown) / columns)
            several = len(conditions) > len(LINES)
            figure = Figure(figsize=(width, 0.6 + height * (rows if several else 2 * rows + 1)), layout="constrained")
            grid = figure.add_gridspec(rows if several else 2 * rows + 1, columns)
            forces = _panels(figure, grid, 0, len(shown))
            colours = [Look("#0072b2", "-", "o")] * len(shown) if several else looks(len(shown))
            for panel, curves, look in zip(forces, drawn[own], colours, strict=True):
                panel.plot(*curves[0].curves[_HAND_FORCE], label="$F_m$", **_REFERENCE)
                _draw(panel, 0, curves, look._replace(style="-"), r"$\alpha_f F_s$" if several else None)
                _draw_published([panel], published)
                _limit(panel, curves, 0, limits[0])
            _describe(forces, columns, *_AXES[0])
            panels = list(forces)
            if not several:
                position = figure.add_subplot(grid[rows, :], sharex=forces[0])
                paths = _panels(figure, grid, rows + 1, len(shown))
                for path, condition, curves, look in zip(paths, shown, drawn, colours, strict=True):
                    _draw(position, 1, curves, look, f"{condition.label}: {condition.outcome}")
                    _draw(path, 2, curves, look._replace(style="-"), None)
                    if path is not paths[0]:
                        path.plot(*drawn[0][0].curves[2], **_REFERENCE)
                    _limit(path, curves, 2, limits[2])
                    _draw_published([path], published, first=2)
                _draw_published([position], published, first=1)
                _limit(position, everyone, 1, limits[1])
                _limit_distance(paths[0], everyone, published)
                _describe([position], 1, *_AXES[1])
                _describe(paths, columns, *_AXES[2])
                panels += [position, *paths]
                options.lettered(panels)
            _limit_time(forces[0], everyone, published)
            for panel, condition in zip(forces, shown, strict=True):
                # A title wider than its panel would overlap the next one.
                title = f"{panel.get_title(loc='left')} {condition.label}: {condition.outcome}".strip()
                lines = textwrap.wrap(title, 28 if paper else 40)
                panel.set_title("\n".join(lines), loc="left", fontsize=6 if paper else 9)
            _legend(figure, panels, 1 if paper else columns)
            figures.append(figure)
    return figures


def _panels(figure: "Figure", grid: "GridSpec", row: int, count: int) -> "list[Axes]":
    """Add panels with the same axes to the rows of a grid from one on."""
    panels: list[Axes] = []
    for number in range(count):
        first = panels[0] if panels else None
        place = grid[row + number // grid.ncols, number % grid.ncols]
        panels.append(figure.add_subplot(place, sharex=first, sharey=first))
    return panels


def _describe(panels: "Sequence[Axes]", columns: int, x: str, y: str) -> None:
    """Name the axes at the left and the lower edge of panels that share them."""
    for number, panel in enumerate(panels):
        is_left, is_lowest = number % columns == 0, number + columns >= len(panels)
        panel.set(xlabel=x if is_lowest else "", ylabel=y if is_left else "")
        panel.tick_params(labelleft=is_left, labelbottom=is_lowest)


def _legend(figure: "Figure", panels: "Sequence[Axes]", columns: int) -> None:
    """Add one legend for all panels below them."""
    named: dict[str, Any] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        for label, handle in zip(labels, handles, strict=True):
            named.setdefault(label, handle)
    if max(map(len, named)) > _WIDE:
        columns = 1
    figure.legend(named.values(), named.keys(), loc="outside lower left", ncols=columns, fontsize=8, frameon=False)


def _draw_published(panels: "Sequence[Axes]", published: Sequence[PublishedPoints], first: int = 0) -> None:
    """Draw published points into the panels of their curves, from that of a place on; each file has a marker."""
    curves = (("tip_force", "hand_force"), ("hand_position",), ("tip_path",))[first:]
    for number, file in enumerate(published):
        look: dict[str, Any] = {
            "marker": _MARKERS[number % len(_MARKERS)],
            "label": "published" if len(published) == 1 else f"published {number + 1}",
        }
        for names, panel in zip(curves, panels, strict=False):
            points = [point for name in names for point in file.of(name)]
            if points:
                x, y, x_error, y_error = zip(*(point[1:5] for point in points), strict=True)
                panel.errorbar(
                    x, y, xerr=x_error, yerr=y_error, color="0.25", ls="", ms=4.0, mfc="white", capsize=2.0, lw=0.9,
                    **look,
                )  # fmt: skip


def _draw(panel: "Axes", place: int, drawn: Sequence[Drawn], look: Look, label: str | None) -> None:
    """Draw the curve at a place of the sessions of a condition into a panel; the first has the label."""
    width = 0.7 if len(drawn) > 1 else 1.0
    for number, session in enumerate(drawn):
        style = ":" if session.diverged else look.style
        panel.plot(*session.curves[place], color=look.colour, ls=style, lw=width, label=None if number else label)


def _limits(curves: Sequence[tuple[Floats, bool]]) -> Limits:
    """Return the limits of an ordinate by the sessions that did not diverge; None if all or none of them diverged."""
    found = [y[np.isfinite(y)] for y, diverged in curves if not diverged]
    if not found or len(found) == len(curves) or not all(y.size for y in found):
        return None
    low, high = min(float(y.min()) for y in found), max(float(y.max()) for y in found)
    margin = _MARGIN * (high - low) or 1.0
    return low - margin, high + margin


def _limit_time(panel: "Axes", drawn: Sequence[Drawn], published: Sequence[PublishedPoints]) -> None:
    """Let the time of panels begin and end with the first and last change of any session, or published point."""
    times = _places(published, "tip_force", "hand_force", "hand_position")
    curves = [one.curves[place] for one in drawn for place in (0, 1, _HAND_FORCE)]
    for x, y in curves:
        y = np.nan_to_num(y)
        least = _FELT * float(np.ptp(y)) if y.size else 0.0
        if least:
            times += [x[np.abs(y - y[0]) > least][0], x[np.abs(y - y[-1]) > least][-1]]
    if times:
        margin = _MARGIN * (max(times) - min(times))
        ends = [*times, *(float(x[place]) for x, _ in curves if x.size for place in (0, -1))]
        panel.set_xlim(max(min(ends), min(times) - margin), min(max(ends), max(times) + margin))


def _places(published: Sequence[PublishedPoints], *names: str) -> list[float]:
    """Return the abscissae of the published points of curves."""
    return [point.x for file in published for name in names for point in file.of(name)]


def _limit_distance(panel: "Axes", drawn: Sequence[Drawn], published: Sequence[PublishedPoints]) -> None:
    """Let the panel of force against distance end where no force is left, as in most of an approach, and no point."""
    curves = [one.curves[2] for one in drawn if not one.diverged] or [one.curves[2] for one in drawn]
    felt = [x[np.abs(y) > _FELT * float(np.nanmax(np.abs(y), initial=0.0))] for x, y in curves]
    felt_nm = np.concatenate([_places(published, "tip_path"), *(x[np.isfinite(x)] for x in felt)])
    if felt_nm.size:
        low, high = float(felt_nm.min()), float(felt_nm.max())
        margin = _MARGIN_OF_DISTANCE * (high - low) or 1.0
        panel.set_xlim(low - margin, high + margin)


def _limit(panel: "Axes", drawn: Sequence[Drawn], place: int, bounds: Limits) -> None:
    """Set the ordinate, and mark with a cross where the curve of a session that diverged first leaves the panel.

    Args:
        panel: The panel.
        drawn: The sessions in it.
        place: The place of their curve in `Drawn.curves`.
        bounds: The limits of the ordinate; None leaves it as it is.
    """
    panel.axhline(0.0, color="0.8", lw=0.8, zorder=-1)
    if bounds is None:
        return
    panel.set_ylim(bounds)
    for x, y in (session.curves[place] for session in drawn if session.diverged):
        outside = np.flatnonzero((y < bounds[0]) | (y > bounds[1]))
        if outside.size:
            at = outside[0]
            look: dict[str, Any] = {"color": "0.1", "ms": 6.0, "clip_on": False, "label": _LEAVES}
            panel.plot([x[at]], [np.clip(y[at], *bounds)], "x", **look)

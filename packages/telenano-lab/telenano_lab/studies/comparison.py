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
    ("tip-sample distance h (nm)", r"$F_s$ (nN)"),
)
# The number of conditions that have their panels in one figure.
_ON_A_PAGE = 24
# Labels longer than this are listed in one column of a legend.
_WIDE = 48
# The margin beyond the curves at each end of an ordinate, as a share of its span.
_MARGIN = 0.08
# The least force that the panel of force against distance shows to its end, as a share of the greatest of its session,
# and the margin beyond it, as a share of the span.
_FELT = 0.02
_MARGIN_OF_DISTANCE = 0.25
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
    """The curves of a session in a figure: x and y of alpha_f F_s and x_m over time, and of F_s against h."""

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

    Up to six conditions are drawn over one another in two panels, alpha_f F_s with F_m of the first session for
    reference, and x_m. F_s against h lies on one curve of the sample whatever the condition, so each condition has a
    panel with it, all with the same axes, over the path of the first. With more than six conditions each has a panel
    with alpha_f F_s alone, all with the same axes, in as many figures as needed. A session that diverged is dotted and
    does not stretch the axes of the others; a cross marks where it leaves them. Published points are drawn beneath,
    with their errors.
    """
    from matplotlib.figure import Figure

    conditions = conditions_in(sessions)
    drawn = [[Drawn.of(session) for session in condition.sessions] for condition in conditions]
    everyone = [one for several in drawn for one in several]
    limits = [_limits([(one.curves[place][1], one.diverged) for one in everyone]) for place in range(len(_AXES))]
    with options.styled():
        if len(conditions) > len(LINES):
            parts = (slice(first, first + _ON_A_PAGE) for first in range(0, len(conditions), _ON_A_PAGE))
            return [_multiples(conditions[part], drawn[part], options, published, limits[0]) for part in parts]
        paper = options.style == "paper"
        columns = min(len(conditions), 2 if paper else 3)
        rows = math.ceil(len(conditions) / columns)
        width, height = (FigureOptions.COLUMN_IN, 2.2) if paper else (7.6, 3.1)
        figure = Figure(figsize=(width, height * (2 + rows)), layout="constrained")
        grid = figure.add_gridspec(2 + rows, columns)
        force, position = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
        paths: list[Axes] = []
        for number in range(len(conditions)):
            beside = paths[0] if paths else None
            own_place = grid[2 + number // columns, number % columns]
            paths.append(figure.add_subplot(own_place, sharex=beside, sharey=beside))
        _draw_reference(force, sessions[0], f"$F_m$, {sessions[0].name}", 2.4)
        for condition, own, look, path in zip(conditions, drawn, looks(len(conditions)), paths, strict=True):
            _draw([force, position, path], own, look, f"{condition.label}: {condition.outcome}")
            if path is not paths[0]:
                path.plot(*drawn[0][0].curves[2], color=FigureOptions.REFERENCE, lw=2.4, zorder=0)
            _limit(path, own, 2, limits[2])
            _draw_published([path], published, first=2)
        _draw_published([force, position], published)
        for place, panel in enumerate((force, position)):
            _limit(panel, everyone, place, limits[place])
        _limit_distance(paths[0], everyone)
        panels = [force, position, *paths]
        for panel, (x, y) in zip(panels, (*_AXES[:2], *(_AXES[2:] * len(paths))), strict=True):
            panel.set(xlabel=x, ylabel=y)
        for number, path in enumerate(paths):
            if columns > 1:
                path.set_xlabel("distance h (nm)")
            if number % columns:
                path.set_ylabel("")
                path.tick_params(labelleft=False)
        options.lettered(panels)
        _legend(figure, panels, 1 if paper else 2)
    return [figure]


def _multiples(
    conditions: Sequence[Condition],
    drawn: Sequence[Sequence[Drawn]],
    options: FigureOptions,
    published: Sequence[PublishedPoints],
    limits: Limits,
) -> "Figure":
    """Draw a panel for each condition, with alpha_f F_s of its sessions and F_m of the first for reference."""
    from matplotlib.figure import Figure

    paper = options.style == "paper"
    columns = 2 if paper else 3
    rows = math.ceil(len(conditions) / columns)
    width = FigureOptions.COLUMN_IN if paper else 10.0
    figure = Figure(figsize=(width, 0.6 + 1.8 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel in grid.flat[len(conditions) :]:
        panel.set_axis_off()
    for panel, condition, own in zip(grid.flat, conditions, drawn, strict=False):
        _draw_reference(panel, condition.sessions[0], "$F_m$", 2.0)
        _draw([panel], own, Look("#0072b2", "-", "o"), r"$\alpha_f F_s$")
        _draw_published([panel], published)
        _limit(panel, own, 0, limits)
        # A title wider than its panel would overlap the next one.
        lines = textwrap.wrap(f"{condition.label}: {condition.outcome}", 30 if paper else 44)
        panel.set_title("\n".join(lines), loc="left", fontsize=6 if paper else 8)
    for panel in grid[:, 0]:
        panel.set_ylabel("force (N)")
    for column in range(min(columns, len(conditions))):
        lowest = grid[(len(conditions) - 1 - column) // columns, column]
        lowest.set_xlabel("time (s)")
        lowest.tick_params(labelbottom=True)
    _legend(figure, list(grid.flat), 3)
    return figure


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


def _draw_reference(panel: "Axes", session: ComparedSession, label: str, width: float) -> None:
    """Draw the force of the hand in a session, as the reference for the curves of a panel."""
    series = session.session.series()
    look: dict[str, Any] = {"color": FigureOptions.REFERENCE, "lw": width, "zorder": 0, "label": label}
    panel.plot(series.hand_time_s, series.hand_force_n, **look)


def _draw(panels: "Sequence[Axes]", drawn: Sequence[Drawn], look: Look, label: str) -> None:
    """Draw the sessions of a condition into the panels; the first has the label."""
    width = 0.7 if len(drawn) > 1 else 1.0
    for number, session in enumerate(drawn):
        style = ":" if session.diverged else look.style
        for place, (panel, (x, y)) in enumerate(zip(panels, session.curves, strict=False)):
            named = label if number == place == 0 else None
            panel.plot(x, y, color=look.colour, ls=style, lw=width, label=named)


def _limits(curves: Sequence[tuple[Floats, bool]]) -> Limits:
    """Return the limits of an ordinate by the sessions that did not diverge; None if all or none of them diverged."""
    found = [y[np.isfinite(y)] for y, diverged in curves if not diverged]
    if not found or len(found) == len(curves) or not all(y.size for y in found):
        return None
    low, high = min(float(y.min()) for y in found), max(float(y.max()) for y in found)
    margin = _MARGIN * (high - low) or 1.0
    return low - margin, high + margin


def _limit_distance(panel: "Axes", drawn: Sequence[Drawn]) -> None:
    """Let the panel of force against distance end where no force is left: most of an approach has none."""
    curves = [one.curves[2] for one in drawn if not one.diverged] or [one.curves[2] for one in drawn]
    felt = [x[np.abs(y) > _FELT * float(np.nanmax(np.abs(y), initial=0.0))] for x, y in curves]
    felt_nm = np.concatenate([x[np.isfinite(x)] for x in felt])
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

"""`telenano link fit`: a log of a line becomes settings of the link, with how far they agree with the log."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
import yaml

from telenano.cli.output import print_rows
from telenano.cli.sample_options import results_in
from telenano.extend.commands import JsonOption, print_json, report_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from telenano_networks.line_fit import Agreement, LineModel
    from telenano_networks.line_log import LineLog

_MOST_DRAWN = 20_000
# A quantile that rests on fewer messages is a guess.
_FEWEST_BEYOND = 10


def fit(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="What `ping -D` printed, or tables with columns such as sent_ms and received_ms (or delay_ms).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for settings, profile and page.")] = Path(
        "out/line"
    ),
    unit: Annotated[
        Literal["s", "ms", "us", "ns"] | None,
        typer.Option("--unit", help="Unit of the columns whose headings name none."),
    ] = None,
    round_trip: Annotated[
        bool, typer.Option("--round-trip", help="The delays of a table are round trips, as those of ping are.")
    ] = False,
    without_memory: Annotated[
        bool,
        typer.Option("--without-memory", help="The same distribution, each message drawn by itself: for comparison."),
    ] = False,
    about: Annotated[str, typer.Option("--about", metavar="TEXT", help="What the line is, in one line.")] = "",
    cite: Annotated[str, typer.Option("--cite", metavar="TEXT", help="Where the log is from.")] = "",
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of what is generated.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Make settings of the link from a log of a line: its delays, how long they last, its stalls and its losses.

    The fit of the first half of the log is held against the second half, which it has not seen; exit code 3 when they
    disagree in a statistic.
    """
    with report_errors(as_json):
        from telenano_networks.line_fit import accept, intervals, parameters
        from telenano_networks.line_fit import fit as fitted
        from telenano_networks.line_log import read_log

        log = read_log(logs, unit, round_trip=round_trip)
        model, table = fitted(log), accept(log, seed)
        bounds = intervals(log, seed)
        way = (model.one_way() if log.round_trip else model).settings()
        remarks = _remarks(log, table)
        if without_memory:
            way = _without_memory(way, seed)
            remarks.append("Each message is drawn by itself: the distribution is that of the line, its memory is not.")
        document: dict[str, Any] = {
            "parameters": {
                what: {"value": _known(value), "interval": [_known(edge) for edge in bounds[what]]}
                for what, value in parameters(model).items()
            },
            "agreement": [{key: _known(value) for key, value in row._asdict().items()} for row in table],
            "agrees": all(row.agrees for row in table),
            "round_trip": log.round_trip,
            "remarks": remarks,
            "way": way,
            "files": str(out),
        }
        with results_in(out) as folder:
            (folder / "way.json").write_text(json.dumps(way) + "\n", encoding="utf-8")
            profile = yaml.safe_dump(
                _profile(way, seed, about, cite, remarks),
                sort_keys=False,
                allow_unicode=True,
                default_flow_style=None,
                width=110,
            )
            (folder / "profile.yaml").write_text(profile, encoding="utf-8")
            (folder / "fit.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
            figure = line_figure(log, model, seed)
            figure.savefig(folder / "fit.png", dpi=130)
            _page(figure, document).write(folder / "fit.html")
    if as_json:
        print_json(document)
    else:
        print_rows(_parameter_rows(document))
        print_rows(_agreement_rows(document))
        for remark in remarks:
            typer.echo(remark)
        typer.echo(f"{out}: way.json has the settings of one way, profile.yaml the network, fit.html the page")
    if not document["agrees"]:
        raise typer.Exit(3)


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def _remarks(log: "LineLog", table: "list[Agreement]") -> list[str]:
    messages = sum(len(part.sent_s) for part in log.segments)
    found = list(log.cuts)
    if log.round_trip:
        found.append(
            "The log has round trips. One way gets half of each usual delay, and half as many stalls and losses, each "
            "as long; how they are shared in truth, no round trip says."
        )
    found.append(
        f"The log has a message each {1e3 * log.period_s:.3g} ms. Between them the model goes on as at them; what "
        "lasts less is not in the log."
    )
    stalls = sum(row.measured > 0.0 for row in table if row.what == "stalls per minute")
    if not stalls:
        found.append("The second half of the log has no stall that could be seen: how long one lasts is not tested.")
    if messages * 1e-3 < _FEWEST_BEYOND:
        found.append(f"{messages} messages say little of the slowest in a thousand.")
    apart = [row.what for row in table if not (row.low <= row.other_half <= row.high or math.isnan(row.other_half))]
    if apart:
        found.append(f"The halves of the log differ by more than chance in {', '.join(apart)}: it is not stationary.")
    return found


def _sent(way: dict[str, Any], seed: int) -> list[Any]:
    """Return the fates of messages at 200 Hz for ten minutes."""
    from services.delay_node.config import parse_settings
    from services.delay_node.engine import fates_of

    settings = parse_settings({"seed": seed, "forward": way})
    return fates_of(settings, "forward", "teleop/forward", range(0, 600 * 10**9, 5 * 10**6), 300)


def _without_memory(way: dict[str, Any], seed: int) -> dict[str, Any]:
    """Return settings whose messages have the delays and the losses of a line, each by itself."""
    import numpy as np

    from telenano_networks.line_fit import quantiles_text

    fates = _sent(way, seed)
    delays_s = np.array([1e-9 * fate.delay_ns for fate in fates if not fate.dropped])
    jitter = {"distribution": "table", "scale_s": 1.0, "quantiles": quantiles_text(delays_s)}
    return {"jitter": jitter, "loss": {"probability": 1.0 - len(delays_s) / len(fates)}}


def _profile(way: dict[str, Any], seed: int, about: str, cite: str, remarks: list[str]) -> dict[str, Any]:
    """Return a network of presets/networks, with the statistics that its messages have."""
    import numpy as np

    fates = _sent(way, seed)
    delays_ms = np.array([1e-6 * fate.delay_ns for fate in fates if not fate.dropped])
    middle = np.quantile(delays_ms, (0.25, 0.5, 0.75)).round(2).tolist()
    statistics = {
        "mean_ms": round(float(delays_ms.mean()), 2),
        "percentiles_ms": dict(zip((25, 50, 75), middle, strict=True)),
        "lost": round(float(np.mean([bool(fate.dropped) for fate in fates])), 5),
        "overtakes": any(fate.reordered for fate in fates),
    }
    return {
        "about": about or "a line that was measured",
        "source": [{"cite": cite, "taken": "all messages of the log, by telenano link fit"}] if cite else [],
        "assumed": remarks,
        "statistics": {direction: statistics for direction in ("forward", "backward")},
        "link": {direction: way for direction in ("forward", "backward")},
    }


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _parameter_rows(document: dict[str, Any]) -> list[dict[str, str]]:
    return [
        {
            "of the line": what,
            "value": _text(one["value"]),
            "95 %": " to ".join(_text(edge) for edge in one["interval"]),
        }
        for what, one in document["parameters"].items()
    ]


def _agreement_rows(document: dict[str, Any]) -> list[dict[str, str]]:
    return [
        {
            "second half of the log": row["what"],
            "measured": _text(row["measured"]),
            "95 %": f"{_text(row['low'])} to {_text(row['high'])}",
            "generated": _text(row["generated"]),
            "first half": _text(row["other_half"]),
            "agrees": "yes" if row["agrees"] else "no",
        }
        for row in document["agreement"]
    ]


def _page(figure: "Figure", document: dict[str, Any]) -> Any:
    from analysis.page import Page, png_of

    page = Page("A line, measured and generated")
    page.image(png_of(figure), "measured beside generated: delay, its tail, its autocorrelation, length of stalls")
    for heading, rows in (("The model", _parameter_rows(document)), ("Agreement", _agreement_rows(document))):
        page.heading(heading)
        page.table(list(rows[0]), [list(row.values()) for row in rows])
    for remark in document["remarks"]:
        page.paragraph(remark)
    return page


def line_figure(log: "LineLog", model: "LineModel", seed: int) -> "Figure":
    """Draw measured beside generated: delay over time, tail of its distribution, autocorrelation, length of stalls."""
    import numpy as np
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    from telenano_networks.line_fit import autocorrelation, generated, scale_of, stalls_of

    scale, made = scale_of(log), generated(model, log, seed)
    figure = Figure(figsize=(9.5, 6.5), layout="constrained")
    (course, tail), (memory, lengths) = figure.subplots(2, 2)
    longest = max(range(len(log.segments)), key=lambda n: len(log.segments[n].sent_s))
    for name, one, colour in (("measured", log, "C0"), ("generated", made, "C1")):
        part = one.segments[longest]
        some = slice(None, _MOST_DRAWN)
        course.plot(part.sent_s[some], 1e3 * part.delay_s[some], ".", ms=2, color=colour, label=name, alpha=0.6)
        delays_ms = np.sort(1e3 * np.concatenate([p.delay_s[~np.isnan(p.delay_s)] for p in one.segments]))
        tail.plot(delays_ms, 1.0 - np.arange(len(delays_ms)) / len(delays_ms), color=colour, label=name)
        lags_s, values = autocorrelation(one)
        memory.plot(lags_s, values, ".-", color=colour, label=name)
        late_ms = np.sort([1e3 * stall.late_s for p in one.segments for stall in stalls_of(p, scale)])
        if len(late_ms):
            share = 1.0 - np.arange(len(late_ms)) / len(late_ms)
            lengths.step(late_ms, share, color=colour, label=f"{name}, {len(late_ms)}")
    course.set(xlabel="time [s]", ylabel="delay [ms]", yscale="log")
    tail.set(xlabel="delay [ms]", ylabel="share that takes longer", xscale="log", yscale="log")
    memory.set(xlabel="lag [s]", ylabel="autocorrelation", xscale="log")
    lengths.set(xlabel="the first message of a stall is late by [ms]", ylabel="share that is longer")
    for axis in (course.yaxis, tail.xaxis, memory.xaxis):
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    for axes in (course, tail, memory, lengths):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small")
    return figure

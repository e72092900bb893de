"""`telenano link fit`: fit settings of the link to a log of a line, and report how far they agree with the log."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
import yaml

from telenano.cli import JsonOption, Void, print_json, print_rows, report_errors, results_in, rules
from telenano.wire import ConfigError

if TYPE_CHECKING:
    from telenano_lab.networks.line_fit import Agreement
    from telenano_lab.networks.line_log import LineLog

# A quantile with fewer messages beyond it is a guess.
_FEWEST_BEYOND = 10
# A change of the line can be seen in halves with at least this number of correlation times.
_FEWEST_TIMES = 30.0


@rules(
    Void("--taken", "the source of which it says what was used", unless="--cite"),
    Void(
        "--round-trip, --without-memory, --period, --direction, --anyway",
        "which has neither times nor an order",
        beside="--histogram",
    ),
)
def fit(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="Output of `ping -D`, tables with columns such as sent_ms and received_ms (or delay_ms), recordings "
            "of a rig, or traces of the times at which a line could deliver [ms].",
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
        typer.Option(
            "--without-memory", help="Draw each message by itself from the same distribution, for comparison."
        ),
    ] = False,
    period: Annotated[
        float | None,
        typer.Option("--period", metavar="S", min=1e-6, help="Time between two messages of a log without times [s]."),
    ] = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Write the settings even if the model is not like the log.")
    ] = False,
    about: Annotated[str, typer.Option("--about", metavar="TEXT", help="The line (network) in one line.")] = "",
    cite: Annotated[str, typer.Option("--cite", metavar="TEXT", help="Source of the log.")] = "",
    taken: Annotated[
        str | None,
        typer.Option(
            "--taken",
            metavar="TEXT",
            help="Part of the log of --cite that was used, and how; default: all messages of the log, by telenano "
            "link fit.",
        ),
    ] = None,
    histogram: Annotated[
        bool,
        typer.Option("--histogram", help="The log is rows of a bin's lower edge and its count."),
    ] = False,
    direction: Annotated[
        Literal["forward", "backward"] | None,
        typer.Option("--direction", help="Direction of a recording that counts; default: forward."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the generated messages.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Make settings of the link from a log of a line: its delays, how long they last, its stalls and its losses.

    The fit of the first half of the log is compared with the second half, which it has not seen; if they disagree in a
    statistic the exit code is 3, and no settings are written without --anyway.
    """
    with report_errors(as_json):
        source = (cite, taken or "all messages of the log, by telenano link fit")
        if histogram:
            _show(_of_histogram(logs, unit, out, seed, about, source), out, as_json)
            return
        from telenano.analysis import png_of
        from telenano_lab.networks.line_fit import accept, generated, intervals, parameters
        from telenano_lab.networks.line_fit import fit as fitted
        from telenano_lab.networks.line_log import read_log
        from telenano_lab.networks.line_page import line_figure

        log = read_log(logs, unit, round_trip=round_trip, direction=direction, period_s=period)
        model, table = fitted(log), accept(log, seed, with_memory=not without_memory)
        bounds = intervals(log, seed)
        ways = model.ways(round_trip=log.round_trip, with_memory=not without_memory, seed=seed)
        remarks = _remarks(log, table)
        if without_memory:
            remarks.append(
                "Each message is drawn by itself: delays and losses are those of the line, and its correlation, stalls "
                "and runs of loss are not in the settings."
            )
        told = {what: _denied(what, value, bounds[what]) for what, value in parameters(model).items()}
        remarks += [f"{reason}: a longer log would tell it." for reason in told.values() if reason]
        document: dict[str, Any] = {
            "parameters": {
                what: {
                    "value": None if told[what] else _known(value),
                    "interval": [_known(edge) for edge in bounds[what]],
                }
                for what, value in parameters(model).items()
            },
            "agreement": [{key: _known(value) for key, value in row._asdict().items()} for row in table],
            "agrees": all(row.agrees for row in table),
            "round_trip": log.round_trip,
            "remarks": remarks,
            "way": ways["forward"],
            "ways": ways,
            "files": str(out),
        }
        document["written"] = document["agrees"] or anyway
        with results_in(out) as folder:
            _write(folder, document, _profile(ways, seed, about or "a line that was measured", source, remarks))
            picture = png_of(line_figure(log, generated(ways, log, seed)))
            (folder / "fit.png").write_bytes(picture)
            _page(picture, document).write(folder / "fit.html")
    _show(document, out, as_json)
    if not document["agrees"]:
        raise typer.Exit(3)


def _of_histogram(
    logs: list[Path], unit: str | None, out: Path, seed: int, about: str, source: tuple[str, str]
) -> dict[str, Any]:
    """Write settings and profile of a histogram, which has no memory."""
    from telenano_lab.networks.line_fit import SHARES, quantiles_text
    from telenano_lab.networks.line_log import UNITS_S
    from telenano_lab.networks.line_sources import read_histogram

    if len(logs) != 1:
        raise ConfigError(f"{len(logs)} histograms cannot be one; give each by itself")
    histogram = read_histogram(logs[0], None if unit is None else UNITS_S[unit])
    quantiles = quantiles_text(zip(SHARES, histogram.quantiles_s(SHARES), strict=True))
    way = {"jitter": {"distribution": "table", "scale_s": 1.0, "quantiles": quantiles}}
    ways = {"forward": way, "backward": way}
    remarks = [
        "No memory known: a histogram does not say which messages came one after the other. Each message drawn by "
        "itself; stalls, runs of loss and order are not in it."
    ]
    document = {
        "parameters": {}, "agreement": [], "agrees": None, "remarks": remarks, "way": way, "ways": ways,
        "files": str(out), "written": True,
    }  # fmt: skip
    with results_in(out) as folder:
        _write(
            folder, document, _profile(ways, seed, f"{about or 'a measured line'} (no memory known)", source, remarks)
        )
    return document


def _write(folder: Path, document: dict[str, Any], profile: dict[str, Any]) -> None:
    if document["written"]:
        for name, content in (("way", document["way"]), ("way_back", document["ways"]["backward"])):
            (folder / f"{name}.json").write_text(json.dumps(content) + "\n", encoding="utf-8")
        text = yaml.safe_dump(profile, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)
        (folder / "profile.yaml").write_text(text, encoding="utf-8")
    (folder / "fit.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _show(document: dict[str, Any], out: Path, as_json: bool) -> None:
    if as_json:
        print_json(document)
        return
    for rows in (_parameter_rows(document), _agreement_rows(document)):
        if rows:
            print_rows(rows)
    for remark in document["remarks"]:
        typer.echo(remark)
    if document["written"]:
        typer.echo(f"{out}: way.json and way_back.json have the settings of both ways, profile.yaml the network")
    else:
        apart = ", ".join(row["what"] for row in document["agreement"] if not row["agrees"])
        typer.echo(
            f"{out}: no settings are written, because the model is not like the log in {apart}; --anyway writes them"
        )


def _denied(what: str, value: float, interval: tuple[float, float]) -> str:
    """Return why a length that cannot be zero is not told, by its interval; empty if it is, or is another quantity."""
    from telenano.analysis import DEVIATIONS, denied

    if math.isnan(value) or not what.startswith(("usual delay", "length of a stall", "lost in a row")):
        return ""
    name, _, unit = what.removesuffix("]").partition(" [")
    reason = denied(f"the log's {name}", value, 0.5 * (interval[1] - interval[0]) / DEVIATIONS, unit)
    return reason[:1].upper() + reason[1:]


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def _remarks(log: "LineLog", table: "list[Agreement]") -> list[str]:
    from telenano_lab.networks.line_halves import lasting_s

    messages = sum(len(part.sent_s) for part in log.segments)
    groups = _grouped(log.cuts)
    if log.round_trip:
        groups.append(
            "The log has round trips. All that varies, stalls and losses go forward, and half of the least delay back, "
            "so that the sum is that of the log; how they are shared in truth, no round trip says."
        )
    groups.append(
        f"The log has a message each {1e3 * log.period_s:.3g} ms. Between them the model is as at them; what "
        "lasts less is not in the log."
    )
    if any(row.what == "stalls per minute" and row.measured > 0.0 for row in table):
        groups.append(
            "The log does not say how much the line holds while it stands still; 20 000 messages or 4 MiB are assumed."
        )
    stalls = sum(row.measured > 0.0 for row in table if row.what == "stalls per minute")
    if not stalls:
        groups.append("The second half of the log has no stall that could be seen: how long one lasts is not tested.")
    if messages * 1e-3 < _FEWEST_BEYOND:
        groups.append(f"{messages} messages say little of the slowest in a thousand.")
    apart = [row.what for row in table if row.halves_differ]
    if apart:
        groups.append(f"The halves of the log differ by more than chance in {', '.join(apart)}: it is not stationary.")
    time_s, half_s = lasting_s(log)
    if half_s < _FEWEST_TIMES * time_s:
        groups.append(
            f"The delay takes {time_s:.3g} s to forget what it was, and a half of the log has {half_s / time_s:.2g} of"
            " these times: whether the line stays as it is cannot be said of so few; a log of"
            f" {2.0 * _FEWEST_TIMES * time_s:.3g} s could say it."
        )
    unlike = [
        f"{row.what} ({row.measured:.3g} measured, {row.generated:.3g} generated)" for row in table if not row.agrees
    ]
    if unlike:
        groups.append(f"The model is not like the second half of the log in {', '.join(unlike)}.")
    return groups


def _grouped(cuts: Iterable[str]) -> list[str]:
    """Return sentences about logs; a sentence about several logs comes once, with their number."""
    about: dict[str, list[str]] = {}
    for cut in cuts:
        name, text = cut.split(": ", 1)
        about.setdefault(text, []).append(name)
    return [
        f"{names[0]}{f' and {len(names) - 1} others' if len(names) > 1 else ''}: {text}"
        for text, names in about.items()
    ]


def _profile(
    ways: dict[str, dict[str, Any]], seed: int, about: str, source: tuple[str, str], remarks: list[str]
) -> dict[str, Any]:
    """Return a network of telenano/settings/networks, with the statistics of its messages."""
    statistics: dict[str, Any] = {}
    for direction, way in ways.items():
        same = next((other for other in statistics if ways[other] == way), None)
        statistics[direction] = statistics[same] if same else _statistics_of(way, seed)
    return {
        "about": about,
        "source": [{"cite": source[0], "taken": source[1]}] if source[0] else [],
        "assumed": remarks,
        "statistics": statistics,
        "link": ways,
    }


def _statistics_of(way: dict[str, Any], seed: int) -> dict[str, Any]:
    import numpy as np

    from telenano_lab.networks.line_fit import sent

    # Stalls are rare, and may make up most of the mean, so a long time is generated.
    _, delay_ns = sent(way, seed, minutes=200)
    # Overtaking is counted at the rate of the loop, where the next message is a millisecond younger.
    sent_ns, of_loop_ns = sent(way, seed, minutes=2)
    lost = np.isnan(delay_ns)
    delays_ms = 1e-6 * delay_ns[~lost]
    middle = np.quantile(delays_ms, (0.25, 0.5, 0.75)).round(2).tolist()
    return {
        "mean_ms": round(float(delays_ms.mean()), 2),
        "percentiles_ms": dict(zip((25, 50, 75), middle, strict=True)),
        "lost": round(float(lost.mean()), 5),
        "overtakes": bool((np.diff((sent_ns + of_loop_ns)[~np.isnan(of_loop_ns)]) < 0.0).any()),
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
            "first half": _text(row["other_half"]) + (", differs" if row["halves_differ"] else ""),
            "agrees": "-" if None in (row["measured"], row["generated"]) else "yes" if row["agrees"] else "no",
        }
        for row in document["agreement"]
    ]


def _page(picture: bytes, document: dict[str, Any]) -> Any:
    from telenano.analysis import Page

    page = Page("A line, measured and generated")
    page.image(picture, "measured beside generated: delay, distributions, autocorrelation, stalls, losses, age")
    for heading, rows in (("The model", _parameter_rows(document)), ("Agreement", _agreement_rows(document))):
        page.heading(heading)
        page.table(list(rows[0]), [list(row.values()) for row in rows])
    for remark in document["remarks"]:
        page.paragraph(remark)
    return page

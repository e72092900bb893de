"""`telenano link report`: show the effect of the link on a recording's messages, from its own account of each."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli import JsonOption, print_json, print_rows, report_errors
from telenano.wire import TelenanoError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

_WAYS = ("forward", "backward")
_SHARES = (("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p999", 0.999), ("max", 1.0))


def report(
    recording: Annotated[Path, typer.Argument(metavar="FILE", help="Recording of a rig or of `telenano link udp`.")],
    topic: Annotated[
        str | None,
        typer.Option("--topic", metavar="NAME", help="Topic of the messages; default: the one with most."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the effect of the link on the messages of a recording: delay, loss, stalls and order, by direction."""
    with report_errors(as_json):
        fates = fates_in(recording)
        ways = {way: figures(rows, topic) for way, rows in fates.items()}
        for way, count in overflows_in(recording).items():
            ways[way]["dropped"]["the socket had no room"] = count
        if not any(row["messages"] for row in ways.values()):
            directions = sorted({fate[0] for rows in fates.values() for fate in rows})
            wanted = (
                f"link/fates has no message of {topic}; it has {', '.join(directions)}"
                if directions
                else "has no link/fates"
            )
            raise TelenanoError(f"{recording}: {wanted}")
    if as_json:
        print_json({"recording": str(recording), **ways})
        return
    keys = [key for key in ways["forward"] if key != "dropped"]
    rows = [{"what": key, **{way: _text(ways[way][key]) for way in _WAYS}} for key in keys]
    causes = sorted({cause for way in ways.values() for cause in way["dropped"]})
    rows += [
        {"what": f"dropped: {cause}", **{way: str(ways[way]["dropped"].get(cause, 0)) for way in _WAYS}}
        for cause in causes
    ]
    print_rows(rows)


# For a message: topic, seq, time of arrival, delay and time held [ns], cause of a drop, and whether it was overtaken.
FateRow = tuple[str, int, int, int, int, str, bool]


def fates_in(recording: Path) -> dict[str, list[FateRow]]:
    """Return the fate of each message, without copies, by direction and in the order of arrival.

    Raises:
        RecordingError: The file is no recording.
    """
    from telenano.recording import Recording

    fates_of: dict[str, list[FateRow]] = {way: [] for way in _WAYS}
    for message in Recording(recording).messages(("link/fates",)):
        report = message.checked_fields()
        fates_of[report["direction"]] += [
            (
                *(row["topic"], row["seq"], row["arrived_ns"], row["delay_ns"]),
                *(row["held_ns"], row["dropped"], row["reordered"]),
            )
            for row in report["fates"]
            if not row["is_duplicate"]
        ]
    for rows in fates_of.values():
        rows.sort(key=lambda row: row[2])
    return fates_of


def overflows_in(recording: Path) -> dict[str, int]:
    """Return the number of datagrams for which the sockets of `telenano link udp` had no room, by direction, if any.

    Raises:
        RecordingError: The file is no recording.
    """
    from telenano.recording import Recording
    from telenano_lab.networks.udp_command import OVERFLOWED

    counts = Recording(recording).metadata.get(OVERFLOWED, {})
    return {way: int(counts[way]) for way in _WAYS if counts.get(way, "").isdecimal() and int(counts[way])}


def figures(rows: list[FateRow], topic: str | None) -> dict[str, Any]:
    """Return counts, quantiles of the delay [ms], stalls, and the correlation of neighbours in one direction.

    A stall is a run of messages that were held until the same time. `topic` None takes the topic with most messages.
    """
    import numpy as np

    counts: dict[str, int] = {}
    for row in rows:
        counts[row[0]] = counts.get(row[0], 0) + 1
    chosen = topic if topic is not None else max(counts, key=lambda name: counts[name], default="")
    own = [row for row in rows if row[0] == chosen]
    sent = [row for row in own if not row[5]]
    dropped: dict[str, int] = {}
    for row in own:
        if row[5]:
            dropped[row[5]] = dropped.get(row[5], 0) + 1
    delays_ms = np.array([row[3] for row in sent], dtype=np.float64) * 1e-6
    quantiles = {
        f"delay_{name}_ms": float(np.quantile(delays_ms, share)) if len(delays_ms) else None for name, share in _SHARES
    }
    ends = [row[2] + row[4] for row in sent if row[4]]
    held_ms = [row[4] * 1e-6 for row in sent if row[4]]
    return {
        "topic": chosen,
        "messages": len(own),
        "lost_share": (len(own) - len(sent)) / len(own) if own else None,
        "lost_in_a_row": _longest_run([bool(row[5]) for row in own]),
        "overtaken": sum(row[6] for row in own),
        **quantiles,
        "correlation_of_neighbours": _correlation(delays_ms),
        "stalls": len(set(ends)),
        "longest_hold_ms": max(held_ms, default=0.0),
        "dropped": dropped,
    }


def _longest_run(flags: list[bool]) -> int:
    longest = run = 0
    for flag in flags:
        run = run + 1 if flag else 0
        longest = max(longest, run)
    return longest


def _correlation(delays_ms: "npt.NDArray[np.float64]") -> float | None:
    if len(delays_ms) < 3:
        return None
    apart = delays_ms - float(delays_ms.mean())
    square = float((apart * apart).sum())
    return float((apart[1:] * apart[:-1]).sum()) / square if square > 0.0 else None


def _text(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)

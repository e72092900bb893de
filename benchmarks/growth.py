"""How a rig grows: processor time, memory and age of the loop over readers, pages, rate and topics, and where it stops.

    python benchmarks/growth.py [--quick] [--rounds N] [--window S] [--json]
    python benchmarks/growth.py --subscribers 0,32,64 --pages '' --rates '' --topics ''

Each row is its own session (`observers.py`), in which all readers have connected before the window begins. The four
axes are the number of processes that read every topic, the number of pages (clients of the protocol, without a
browser), the rate of the rig, and the number of topics that four processes read, those of the loop first. The rig at 1
kHz without any load is measured before each of the four: its median is the baseline of all ages. The readers are on the
same machine and have their own columns. With more rounds the sessions take turns, and the medians are compared.

A row holds its rate if hand and instrument both have 99 % of it. The sentences name the row from which on none holds it
and the row from which on the age of the loop at 99 % is more than a tick, with its details: messages that a newer one
superseded in the nodes, missed deadlines, the messages that still reach a reader, and the output of `telenano status`
at that moment. They also name a row that fails before one that does not: it was disturbed.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from observers import Load, SessionError, medians, session

from telenano.wire.topics import OWN_TOPICS as TOPICS

# These are sent at the rate of the loop, so the first few topics cost the most.
OF_THE_LOOP = ("haptic/state", "afm/state", "teleop/forward", "teleop/backward", "haptic/command", "afm/command")
IN_ORDER = (*OF_THE_LOOP, *(topic for topic in TOPICS if topic not in OF_THE_LOOP))
READERS_OF_TOPICS = 4
USUAL_HZ = 1000.0
# A rig holds its rate if its hand and its instrument have at least this share of it.
LEAST_SHARE = 0.99
Row = Mapping[str, Any]


class Axis(NamedTuple):
    """A quantity that grows: its title, the words for one and several, and the values of its table, baseline first."""

    title: str
    one: str
    several: str
    values: tuple[int, ...]

    def named(self, value: int) -> str:
        """Return a value with its unit or noun."""
        return f"{value} {self.one if value == 1 else self.several}"


AXES = {
    "subscribers": Axis("processes that read every topic", "process", "processes", (0, 1, 2, 4, 8, 16)),
    "pages": Axis("pages that are connected", "page", "pages", (0, 1, 2, 4, 8, 16, 32)),
    "rates": Axis("rate of the rig", "Hz", "Hz", (1000, 125, 250, 500, 2000, 4000)),
    "topics": Axis(
        f"topics that {READERS_OF_TOPICS} processes read", "topic", "topics", (0, 1, 2, 4, 6, len(IN_ORDER))
    ),
}
# Along these axes a reader receives the same in each row, as long as all goes well.
OF_READERS = ("subscribers", "pages")
COLUMNS = {
    "rig [%]": ("rig_percent", 0),
    "page server [%]": ("server_percent", 0),
    "readers [%]": ("readers_percent", 0),
    "rig [MB]": ("rig_mb", 0),
    "page server [MB]": ("server_mb", 0),
    "readers [MB]": ("readers_mb", 0),
    "p50 [ms]": ("p50_ms", 2),
    "p99 [ms]": ("p99_ms", 2),
    "p50 / baseline": ("p50_ratio", 2),
    "p99 / baseline": ("p99_ratio", 2),
    "hand [Hz]": ("hand_hz", 0),
    "tip [Hz]": ("tip_hz", 0),
    "a reader has [1/s]": ("received_hz", 0),
    "superseded [1/s]": ("superseded_hz", 1),
    "missed [1/s]": ("overruns_hz", 1),
}


def load_of(axis: str, value: int) -> Load:
    """Return the load of a rig for a value of an axis."""
    if axis == "rates":
        return Load(rate_hz=float(value))
    if value == 0:
        return Load()
    if axis == "topics":
        return Load("shared", READERS_OF_TOPICS, topics=IN_ORDER[:value] if value < len(IN_ORDER) else ())
    return Load("shared" if axis == "subscribers" else "pages", value)


def measured(load: Load, window_s: float, folder: Path) -> dict[str, Any]:
    """Return the results of a session, or the reason why it had none (`failed`)."""
    try:
        return {"asked_hz": load.rate_hz, **session(load, window_s, folder, asks_status=True)}
    except SessionError as error:
        return {"asked_hz": load.rate_hz, "failed": str(error)}


def joined(rounds: Sequence[Row]) -> dict[str, Any]:
    """Return one row for the rounds of a value: medians and all status texts, or the first reason if all failed."""
    good = [row for row in rounds if "failed" not in row]
    if not good:
        return dict(rounds[0])
    return {**medians(good), "says": list(dict.fromkeys(text for row in good for text in row["says"]))}


def compared(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the rows of an axis with their ages as ratios to the first one."""
    found = []
    for row in rows:
        ratios = {}
        for name in ("p50", "p99"):
            if f"{name}_ms" in row and f"{name}_ms" in rows[0]:
                ratios[f"{name}_ratio"] = round(row[f"{name}_ms"] / rows[0][f"{name}_ms"], 3)
        found.append({**row, **ratios})
    return found


def holds_rate(row: Row) -> bool:
    """Return whether hand and instrument had the rate that was asked for."""
    return min(row["hand_hz"], row["tip_hz"]) >= LEAST_SHARE * row["asked_hz"]


def within_tick(row: Row) -> bool:
    """Return whether the age of the loop at 99 % is at most a tick."""
    return row["p99_ms"] <= 1e3 / row["asked_hz"]


def rate_of(row: Row) -> str:
    """Return the rates of a row in words."""
    return f"{row['hand_hz']:.0f} Hz at the hand and {row['tip_hz']:.0f} Hz at the tip of {row['asked_hz']:.0f} Hz"


def age_of(row: Row) -> str:
    """Return the age of a row in words."""
    return f"{row['p99_ms']:.2f} ms, where a tick is {1e3 / row['asked_hz']:g} ms"


def where_from(rows: Sequence[Row], is_good: Callable[[Row], bool]) -> tuple[Row | None, list[Row]]:
    """Return the row from which on none is good (None if the last one is), and the rows before it that are not good.

    More load does not make a machine better, so a row that fails before one that does not was disturbed.
    """
    last = max((place for place, row in enumerate(rows) if is_good(row)), default=-1)
    return next(iter(rows[last + 1 :]), None), [row for row in rows[: last + 1] if not is_good(row)]


def where_it_stops(axis: str, rows: Sequence[Row]) -> list[str]:
    """Return sentences on the row from which on the rate is not held, and that from which on the loop is too old.

    The rows are taken in the order of their values. Those rows and the last one with results are described in detail.
    """
    named, ordered = AXES[axis].named, sorted(rows, key=lambda row: row["value"])
    answered = [row for row in ordered if "failed" not in row]
    found, shown = [], dict[int, Row]()
    slow, odd = where_from(answered, holds_rate)
    if slow is not None:
        found.append(f"The rig no longer holds its rate from {named(slow['value'])} on: {rate_of(slow)}.")
        shown[slow["value"]] = slow
    elif answered:
        most = ", the most that was tried" if answered[-1] is ordered[-1] else ""
        found.append(f"The rig holds its rate up to {named(answered[-1]['value'])}{most}.")
    found += [f"At {named(row['value'])} it did not, but with more it did: {rate_of(row)}." for row in odd]
    found += [f"There are no figures at {named(row['value'])}: {row['failed']}." for row in ordered if "failed" in row]
    old, odd = where_from(answered, within_tick)
    if old is not None:
        first = "already " if old is ordered[0] else ""
        found.append(f"The loop is older than a tick at 99 % {first}from {named(old['value'])} on: {age_of(old)}.")
        shown[old["value"]] = old
    elif answered:
        found.append(f"The loop is younger than a tick at 99 % up to {named(answered[-1]['value'])}.")
    found += [f"At {named(row['value'])} it was not, but with more it was: {age_of(row)}." for row in odd]
    if answered:
        # The largest value that was tried shows the effect of the most load.
        shown.setdefault(answered[-1]["value"], answered[-1])
    had_first = next((row["received_hz"] for row in answered if row.get("received_hz")), 0.0)
    for value, row in sorted(shown.items()):
        counts = f"superseded messages {row['superseded_hz']:.0f} /s, missed deadlines {row['overruns_hz']:.0f} /s"
        if axis in OF_READERS and value:
            share = 100.0 * row["received_hz"] / max(1.0, had_first)
            counts += f", messages to a reader {row['received_hz']:.0f} /s ({share:.0f} % of the first row with one)"
        says = "; ".join(row["says"])
        found.append(f"At {named(value)}: {counts}; `telenano status`: {says}{'' if says.endswith('?') else '.'}")
    return found


def measure(wanted: Mapping[str, Sequence[int]], rounds: int, window_s: float) -> dict[str, Any]:
    """Return the rows of each axis, and the sentences."""
    turns: dict[Load, list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory(prefix="tng-") as folder:
        for _ in range(rounds):
            done = set[Load]()
            for axis, value in ((axis, value) for axis, values in wanted.items() for value in values):
                load = load_of(axis, value)
                # All ages are compared with the baseline, so each axis measures it again.
                if load in done and load != Load():
                    continue
                done.add(load)
                begun_s = time.monotonic()
                turns.setdefault(load, []).append(measured(load, window_s, Path(folder)))
                took_s = time.monotonic() - begun_s
                print(f"{AXES[axis].named(value)}: {took_s:.0f} s", file=sys.stderr, flush=True)
    axes = {}
    for axis, values in wanted.items():
        rows = compared([{"value": value, **joined(turns[load_of(axis, value)])} for value in values])
        rows.sort(key=lambda row: row["value"])
        axes[axis] = {"rows": rows, "stops": where_it_stops(axis, rows)}
    return {"rounds": rounds, "window_s": window_s, "axes": axes}


def cells(row: Row, columns: Mapping[str, tuple[str, int]]) -> list[str]:
    """Return the cells of a row, the value first; cells without a result are empty."""
    return [
        f"{row['value']}",
        *(f"{row[name]:.{digits}f}" if name in row else "" for name, digits in columns.values()),
    ]


def columns_of(rows: Sequence[Row]) -> dict[str, tuple[str, int]]:
    """Return the columns in which some row has a value: the rows of an axis may all be without a page, for example."""
    return {head: (name, digits) for head, (name, digits) in COLUMNS.items() if any(row.get(name) for row in rows)}


def print_axis(axis: str, found: Mapping[str, Any]) -> None:
    """Print the table of an axis, and where it stops."""
    columns = columns_of(found["rows"])
    table = [[AXES[axis].several, *columns], *(cells(row, columns) for row in found["rows"])]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    print(f"\n{AXES[axis].title}")
    for line in table:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
    for sentence in found["stops"]:
        print(sentence)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for axis, about in AXES.items():
        given_values = ",".join(map(str, about.values))
        parser.add_argument(f"--{axis}", default=given_values, help=f"{about.title}; the first is the baseline")
    parser.add_argument("--rounds", type=int, default=3, help="sessions of each row, in turn")
    parser.add_argument("--window", type=float, default=5.0, help="length of each measurement [s]")
    parser.add_argument("--quick", action="store_true", help="one round of 2.5 s a row, in five to six minutes")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.quick:
        given.rounds, given.window = 1, 2.5
    if given.smoke:
        given.rounds, given.window = 1, 1.0
        given.subscribers, given.pages, given.rates, given.topics = "0,1", "", "", "1"
    wanted = {axis: [int(value) for value in vars(given)[axis].split(",") if value] for axis in AXES}
    if most := [value for value in wanted["topics"] if not 0 <= value <= len(IN_ORDER)]:
        parser.error(f"--topics: {most[0]} is not within 0 and {len(IN_ORDER)}, the number of topics")
    found = measure({axis: values for axis, values in wanted.items() if values}, given.rounds, given.window)
    if given.json:
        print(json.dumps(found))
        return
    for axis, figures in found["axes"].items():
        print_axis(axis, figures)


if __name__ == "__main__":
    main()

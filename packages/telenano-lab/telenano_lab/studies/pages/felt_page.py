"""The table of felt stiffness: on the page of `study transparency`, and as docs/felt-measured.md from the kept table.

telenano study transparency --frequency 0.3,0.8,2 --stiffness 10,20,40,80 --delay 0,20,60,150 \
      --instrument ideal,real --table csv --out DIR       # its felt.csv is kept as telenano_lab/studies/felt.csv
make regenerate                                       # writes the page from it
"""

import csv
import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from telenano.analysis import Page

KEPT = Path(__file__).resolve().parents[1] / "felt.csv"
COMMAND = (
    "telenano study transparency --frequency 0.3,0.8,2 --stiffness 10,20,40,80 --delay 0,20,60,150"
    " --instrument ideal,real --table csv --out out/felt"
)
# A ratio of felt and true stiffness is far off beyond these.
TOO_HARD, TOO_SOFT = 1.5, 0.6
_NUMBERS = ("round_trip_ms", "stiffness_n_per_m", "frequency_hz", "felt", "low", "high", "sessions", "refusals")
_PAGE = """# Felt stiffness, measured

*Written by `make regenerate` from the table of runs `packages/telenano-lab/telenano_lab/studies/felt.csv` (SHA-256
`{digest}`); for whoever wants to know what a hand will feel of a
sample.*

```sh
{command}
```

makes that table in simulated time, in some {minutes} minutes of one processor, and the same whoever runs it. A hand
presses on a spring and swings; a cell is the stiffness that it feels, Re(F_m/X_m), over the one that is there. Each
cell has {sessions} sessions, which differ in the force (0.8 to 1.3 N), the swing (0.2 to 0.45 N) and the noise; in
brackets is the interval in which one more such session lies 95 times in 100. A cell without a figure has what its
sessions came to, and in how many of them: not stable, ended by the instrument's guard (`guarded`), or moved otherwise
than the hand swung (`other motion`). Lines are constant round trips of the link, and the laws are as they come.

A felt stiffness below 0 is that of a swing in which mass and delay count more than the sample.

## By law

*Far off* are cells in which the hand feels more than {hard:g} or less than {soft:g} of what is there.

{overview}
"""


def kept_rows() -> list[dict[str, Any]]:
    """Return the rows of the kept table."""
    with KEPT.open(encoding="utf-8", newline="") as file:
        return [_read(row) for row in csv.DictReader(file)]


def _read(row: Mapping[str, str]) -> dict[str, Any]:
    return {name: (float(value) if value else None) if name in _NUMBERS else value for name, value in row.items()}


def cell_words(row: Mapping[str, Any]) -> str:
    """Return the text of a cell: ratio and interval, or the reason why there is none."""
    if row["felt"] is None:
        return f"{row['refused'].replace('_', ' ')}, {row['refusals']:.0f} of {row['sessions']:.0f}"
    if row["high"] - row["low"] < 0.005:
        return f"{row['felt']:.2f}"
    return f"{row['felt']:.2f} ({row['low']:.2f} to {row['high']:.2f})"


def write_felt(page: Page, rows: Sequence[Mapping[str, Any]]) -> None:
    """Add the table of felt stiffness to a study's page."""
    page.heading("Felt stiffness")
    page.table(_OVERVIEW, list(_overview(rows)))
    for instrument in dict.fromkeys(row["instrument"] for row in rows):
        page.heading(f"Felt stiffness, instrument {instrument}")
        own = [row for row in rows if row["instrument"] == instrument]
        page.table(_head(own), list(_grid(own)))
    page.paragraph(
        "Stiffness that a hand feels which presses and swings, over the one that is there, and the interval in which"
        " one more session lies 95 times in 100, over the force, the swing and the noise. A cell without a figure has"
        " what its sessions came to, and in how many of them."
    )


_OVERVIEW = ("law", "instrument", "felt over true", "cells", "far off", "no figure")


def _overview(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    for law, instrument in dict.fromkeys((row["law"], row["instrument"]) for row in rows):
        own = [row for row in rows if (row["law"], row["instrument"]) == (law, instrument)]
        known = sorted(row["felt"] for row in own if row["felt"] is not None)
        hard, soft = (sum(value > TOO_HARD for value in known), sum(value < TOO_SOFT for value in known))
        far = [f"{soft} softer"] * bool(soft) + [f"{hard} harder"] * bool(hard)
        between = f"{known[0]:.2f} to {known[-1]:.2f}" if known else "–"
        yield law, instrument, between, str(len(own)), ", ".join(far) or "none", str(len(own) - len(known))


def _head(rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    return ("law", "round trip [ms]", "swing [Hz]", *(f"{k:g} N/m" for k in _stiffnesses(rows)))


def _stiffnesses(rows: Sequence[Mapping[str, Any]]) -> list[float]:
    return sorted({row["stiffness_n_per_m"] for row in rows})


def _grid(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    places = dict.fromkeys((row["law"], row["round_trip_ms"], row["frequency_hz"]) for row in rows)
    by_place = {(*_place(row), row["stiffness_n_per_m"]): row for row in rows}
    for place in places:
        cells = [by_place.get((*place, k)) for k in _stiffnesses(rows)]
        law, trip_ms, hz = place
        yield law, f"{trip_ms:g}", f"{hz:g}", *("–" if cell is None else cell_words(cell) for cell in cells)


def _place(row: Mapping[str, Any]) -> tuple[str, float, float]:
    return row["law"], row["round_trip_ms"], row["frequency_hz"]


def markdown() -> str:
    """Return docs/felt-measured.md from the kept table."""
    rows = kept_rows()
    text = _PAGE.format(
        digest=hashlib.sha256(KEPT.read_bytes()).hexdigest(),
        command=COMMAND.replace(" --delay", " \\\n  --delay"),
        minutes=MINUTES,
        sessions=f"{rows[0]['sessions']:.0f}",
        hard=TOO_HARD,
        soft=TOO_SOFT,
        overview=_table(_OVERVIEW, ((f"`{law}`", *rest) for law, *rest in _overview(rows))),
    )
    for instrument in dict.fromkeys(row["instrument"] for row in rows):
        own = [row for row in rows if row["instrument"] == instrument]
        grid = ((f"`{law}`", *rest) for law, *rest in _grid(own))
        text += f"\n## Instrument {instrument}\n\n{_table(_head(own), grid)}\n"
    return text


# The time that the command took on one processor [min].
MINUTES = 8


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])

"""The conditions that each law was shown to hold in the benchmark, and whether a session is outside of them.

    table = read_shown()
    outside(table["wave"], Session(round_trip_ms=Estimate(78.0, 77.0, 79.0)))   # None: it was shown to hold that

A session is described by the age of the hand's sample to which the newest answer responds, its unevenness, the
stiffness of the sample and its drift, each with an interval, or None if unknown. A law was shown to hold a place if
cells of the benchmark that it held are at least as demanding, one of them on a sample as stiff without a failed cell
between, and one on a sample as soft, and if every cell that it failed and that is as easy as the place is outweighed by
a harder one that it held and that is as easy. So nothing beyond the cells that were run counts as shown, and nothing
between a held cell and a failed one. A session is outside if no place within its intervals was shown.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from operator import le
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

import msgspec

Axis = Literal["line", "stiffness", "drift", "together"]
TABLE = Path(__file__).with_name("shown.json")
# A cell was held if the 95 % interval of its share begins at this value or above: 29 of 32.
_HELD_FROM = 0.75
# It was failed if a smaller share than this was held; if neither applies, there were too few runs.
_FAILED_BELOW = 0.9
# Age that the processes of a rig add to that of the benchmark's loop in one process [ms].
RIG_MS = 6.0
# Contribution of a rig to each figure of a session, in their order.
_ADDED_BY_RIG = (RIG_MS, RIG_MS, 0.0, 0.0)
_NOTHING = (0.0, 0.0, 0.0, 0.0)


class Estimate(NamedTuple):
    """An estimate and its interval of 95 %."""

    value: float
    low: float
    high: float


class Session(NamedTuple):
    """The estimates of a session: ages [ms], stiffness [N/m], drift [pm/s]; None where unknown."""

    round_trip_ms: Estimate | None = None
    unevenness_ms: Estimate | None = None
    stiffness_n_per_m: Estimate | None = None
    drift_pm_per_s: Estimate | None = None


class Place(NamedTuple):
    """A point among the cells: mean age and unevenness [ms], stiffness [N/m], and drift [pm/s]."""

    round_trip_ms: float
    unevenness_ms: float
    stiffness_n_per_m: float
    drift_pm_per_s: float

    def is_as_easy_as(self, other: "Place") -> bool:
        """Return whether no coordinate is more demanding than the other place's."""
        return all(map(le, self, other))


class Cell(NamedTuple):
    """The runs of a law at a place."""

    place: Place
    runs: int
    held: int
    low: float

    @property
    def was_held(self) -> bool:
        return self.low >= _HELD_FROM

    @property
    def was_failed(self) -> bool:
        return not self.was_held and self.runs > 0 and self.held / self.runs < _FAILED_BELOW


class LawRange:
    """The range that a law was shown to hold; tracking_error: median over its held runs."""

    def __init__(self, cells: Sequence[Cell], tracking_error: float | None) -> None:
        self.held = tuple(cell.place for cell in cells if cell.was_held)
        self.failed = tuple(cell.place for cell in cells if cell.was_failed)
        self.tracking_error = tracking_error

    def holds(self, place: Place) -> bool:
        """Return whether the law was shown to hold a place."""
        softest = min(
            (held.stiffness_n_per_m for held in self.held if _on_as_hard_a_line(held, place)), default=math.inf
        )
        if softest > place.stiffness_n_per_m:
            return False
        easier = [held for held in self.held if held.is_as_easy_as(place)]
        # A failed cell is outweighed by a harder one that was held and is still as easy as the place.
        return any(self._leads_to(place, held) for held in self.held) and all(
            any(failed.is_as_easy_as(held) for held in easier) for failed in self.failed if failed.is_as_easy_as(place)
        )

    def _leads_to(self, place: Place, held: Place) -> bool:
        """Return whether a held cell is at least as hard as a place, without a failed one between them."""
        return place.is_as_easy_as(held) and not any(
            place.is_as_easy_as(failed) and failed.is_as_easy_as(held) for failed in self.failed
        )

    def holds_some(self, session: Session, added: Sequence[float] = _ADDED_BY_RIG) -> bool:
        """Return whether the law was shown to hold some place within the intervals of a session.

        Args:
            session: The estimates of the session.
            added: The greatest contribution of the rig itself to each figure.
        """
        return any(map(self.holds, {Place(*map(_clipped, held, session, added)) for held in self.held}))

    def fits(self, session: Session) -> bool:
        """Return whether the law was shown to hold a session, with any of the held values for its unknown figures."""
        most = [None if one is None else one.value for one in session]
        least = [
            None if value is None else max(0.0, value - own) for value, own in zip(most, _ADDED_BY_RIG, strict=True)
        ]
        places = {
            Place(*(own if value is None else value for own, value in zip(held, ends, strict=True)))
            for held in self.held
            for ends in (least, most)
        }
        return bool(places) and all(map(self.holds, places))


def _on_as_hard_a_line(held: Place, place: Place) -> bool:
    return place._replace(stiffness_n_per_m=held.stiffness_n_per_m).is_as_easy_as(held)


def _clipped(value: float, estimate: Estimate | None, added: float) -> float:
    """Return the value nearest to `value` in an estimate's interval, which the rig's share extends downwards."""
    return value if estimate is None else max(0.0, estimate.low - added, min(value, estimate.high))


class _Line(msgspec.Struct):
    round_trip_ms: float
    unevenness_ms: float


class _Law(msgspec.Struct):
    tracking_error: float | None
    cells: list[tuple[str, float, float, int, int, float, float, int]]


class _Table(msgspec.Struct):
    benchmark: int
    digest: str
    lines: dict[str, _Line]
    laws: dict[str, _Law]


@cache
def read_shown(path: Path = TABLE) -> Mapping[str, LawRange]:
    """Return the range of each law in a table, by name; raise OSError or msgspec.MsgspecError if it cannot be read."""
    table = msgspec.json.decode(path.read_bytes(), type=_Table)
    return {
        name: LawRange(
            [
                Cell(Place(table.lines[line].round_trip_ms, table.lines[line].unevenness_ms, k, drift), runs, held, low)
                for line, k, drift, runs, held, low, _, _ in law.cells
            ],
            law.tracking_error,
        )
        for name, law in table.laws.items()
    }


def outside(shown: LawRange, session: Session) -> Axis | None:
    """Return the axis by which a session is outside a law's range; None if it may be inside.

    It is `together` if line, sample and drift were each shown, but not in this combination.
    """
    if shown.holds_some(session):
        return None
    alone: dict[Axis, Session] = {
        "line": Session(session.round_trip_ms, session.unevenness_ms),
        "stiffness": Session(stiffness_n_per_m=session.stiffness_n_per_m),
        "drift": Session(drift_pm_per_s=session.drift_pm_per_s),
    }
    return next((axis for axis, part in alone.items() if not shown.holds_some(part)), "together")


def advice(
    table: Mapping[str, LawRange],
    law: str,
    axis: Axis,
    session: Session,
    choices: Sequence[str],
    absent: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return sentences on what happened, what it means and what to do.

    Args:
        table: The range of each law.
        law: The law in force.
        axis: The axis by which the session is outside.
        session: The estimates of the session.
        choices: The laws that can be selected instead.
        absent: Laws that are available once their package is installed, with its place; named only if no other fits.
    """
    happened, remedy = _HAPPENED[axis](table[law], law, session)
    means = "The hand may feel an oscillation, or the tip may rest at another force than intended."
    fitting = [name for name in (*choices, *absent) if name != law and name in table and table[name].fits(session)]
    nearest = min(fitting, key=lambda name: (name in absent, table[name].tracking_error or math.inf, name), default="")
    if nearest:
        where = f"; {absent[nearest]}" if nearest in absent else ""
        return f"{happened} {means} Take {nearest} (--set controller.law={nearest}) or {remedy}{where}."
    return f"{happened} {means} Take {remedy}: no law held such a session in the benchmark."


def _of_line(shown: LawRange, law: str, session: Session) -> tuple[str, str]:
    there, uneven = session.round_trip_ms, session.unevenness_ms
    beginning = f"The line is outside of the range in which {law} held in the benchmark: "
    there_ms = f"{there.value:.0f} ms there and back" if there is not None else "any length"
    if there is not None and not shown.holds_some(Session(there)):
        return f"{beginning}{there_ms}, {_up_to(shown, session)}.", "a shorter line"
    lengths = Session(there)
    held = {place.unevenness_ms for place in shown.held}
    most = max(
        (ms for ms in held if shown.holds_some(lengths._replace(unevenness_ms=Estimate(ms, ms, ms)))), default=0.0
    )
    longer = uneven.value if uneven is not None else 0.0
    return (
        f"{beginning}{there_ms}, at times {longer:.0f} ms more, and it held up to {most:.0f} ms more.",
        "a steadier line",
    )


def _of_stiffness(shown: LawRange, law: str, session: Session) -> tuple[str, str]:
    held, estimate = [place.stiffness_n_per_m for place in shown.held], session.stiffness_n_per_m
    if estimate is None or not held:
        return f"{law} held no sample in the benchmark.", "another law"
    softer = estimate.high < min(held)
    text = f"{estimate.low:.3g} to {estimate.high:.3g} N/m, where it held {min(held):g} to {max(held):g} N/m"
    return (
        f"The sample is {'softer' if softer else 'stiffer'} than those that {law} held in the benchmark: {text}.",
        f"a {'stiffer' if softer else 'softer'} cantilever or sample",
    )


def _of_drift(shown: LawRange, law: str, session: Session) -> tuple[str, str]:
    most = max((place.drift_pm_per_s for place in shown.held), default=0.0)
    limit = f"held up to {most:g} pm/s" if most else "held only without drift"
    text = f"The contact drifts faster than {law} held in the benchmark: {_drift(session)}, and it {limit}."
    return text, "a pause until the instrument rests"


def _of_all(shown: LawRange, law: str, session: Session) -> tuple[str, str]:
    line, sample = session.round_trip_ms, session.stiffness_n_per_m
    parts = [f"{line.value:.0f} ms there and back"] if line is not None else []
    parts += [f"{sample.low:.3g} to {sample.high:.3g} N/m"] if sample is not None else []
    parts += [f"a drift of {_drift(session)}"] if session.drift_pm_per_s is not None else []
    remedy = "a shorter line" if line is not None and line.low > RIG_MS else "a softer sample or an instrument at rest"
    beginning = f"The session is outside of the range in which {law} held in the benchmark: {', '.join(parts)} together"
    return f"{beginning}, {_up_to(shown, session)}.", remedy


def _drift(session: Session) -> str:
    estimate = session.drift_pm_per_s
    return "" if estimate is None else f"{estimate.value:.0f} ± {0.5 * (estimate.high - estimate.low):.0f} pm/s"


def _up_to(shown: LawRange, session: Session) -> str:
    """Return words on the round trips that the law was shown to hold on the sample and with the drift of a session."""
    lengths = {place.round_trip_ms for place in shown.held}
    rest = Session(stiffness_n_per_m=session.stiffness_n_per_m, drift_pm_per_s=session.drift_pm_per_s)
    held = [ms for ms in lengths if shown.holds_some(rest._replace(round_trip_ms=Estimate(ms, ms, ms)), _NOTHING)]
    somewhere = "" if session.stiffness_n_per_m is not None else " on some sample"
    return f"and it held up to {max(held):.0f} ms{somewhere}" if held else "and it held over no line"


_HAPPENED = {"line": _of_line, "stiffness": _of_stiffness, "drift": _of_drift, "together": _of_all}

"""Model of the summary of a session: each key of `summary.json` with its type and its meaning.

`make regenerate` writes its JSON Schema and the page docs/summary.md.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from telenano.analysis.holds import FactKind
from telenano.analysis.interruptions import InterruptionKind
from telenano.analysis.verdict import Kind

_SCHEMA = "https://json-schema.org/draft/2020-12/schema"
_TAKEN_OFF = "with the offset of the slave's clock taken off"
_TYPES = {"string": "text", "boolean": "true or false", "integer": "integer", "number": "number", "null": "null"}
_PAGE = """# The keys of `summary.json`

*Generated from the model of the summary by `make regenerate`; for whoever looks up a figure of a session and its unit.*

`telenano up` and `telenano report` write `summary.json` beside the figure, `telenano report --json` prints it, and
`telenano.open(FILE).summary` returns it as a dictionary. Everything in it is read from the recording. What the session
does not show is `null`. `telenano/settings/schemas/summary.json` is its JSON Schema, made from the same model in
`telenano/analysis/summary.py`, which every summary has to fit.

`[]` stands for each item of a list, `<name>` for any key of a map.
A channel has the name of its topic, followed by `@` and the site where its messages were received behind the link.
The meaning of each verdict is in [the chapter on verdicts](verdicts.md#what-the-verdicts-mean).

"""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


@dataclass(frozen=True)
class OfTip:
    """Computation of a figure of the summary from columns of afm/state within the session, each of shape (n,), n > 0.

    It is part of the type of the key, so that a figure on the tip is declared in one place. The figure is null if the
    session has no sample of the tip, or if `value` returns None. A column that an older recording does not have is
    filled with NaN.
    """

    columns: tuple[str, ...]
    value: Callable[..., float | None]


def _greatest_pull_nn(force_n: npt.NDArray[np.float64]) -> float:
    return float(1e9 * force_n.min(initial=0.0))


class LoopAge(_Part):
    """The ages of the answers that the hand took up in the session."""

    p50: float = Field(description="Median [ms]")
    p99: float = Field(description="99th percentile [ms]")
    max: float = Field(description="Greatest [ms]")


class Package(_Part):
    """A package that brought something to the session."""

    package: str = Field(description="Name of the package")
    version: str = Field(description="Version of the package")
    digest: str = Field(description="SHA-256 of the files of the package")


class FactSummary(_Part):
    """A fact about a hold, besides its verdict."""

    kind: FactKind = Field(description="Kind of the fact")
    value: float = Field(description="Value of the fact, in the SI unit of its quantity")
    text: str = Field(description="The fact in words")


class HoldSummary(_Part):
    """A hold: an interval in which the hand's force stands still, and the course of α_f F_s in it.

    Where a person is the hand, which swings with the loop, a swing of α_f F_s is listed and judged like a hold.
    """

    start_s: float = Field(description="Start of the hold in the session [s]")
    end_s: float = Field(description="End of the hold in the session [s]")
    hand_force_n: float = Field(description="Force F_m with which the hand presses in the hold [N]")
    verdict: Kind = Field(description="Verdict on the hold")
    growth_per_s: float | None = Field(
        description="Growth rate of the mode that decides the verdict [1/s]; null where nothing moves"
    )
    peak_to_peak_n: float = Field(description="Peak-to-peak of the motion at the end of the hold, without noise [N]")
    noise_n: float = Field(description="Standard deviation of the noise of the read-out [N]")
    reason: str = Field(description="The verdict in words")
    facts: list[FactSummary] = Field(
        description="Further facts about it: arrived late, struck, off the force that the law states, hand and tip "
        "parted, nothing moved, interrupted, machine late, contact taken from the force"
    )
    judged_from_s: float | None = Field(
        description="Start of the episode that is judged: contact with the loop closed [s]; null without one"
    )
    judged_to_s: float | None = Field(
        description="End of that episode [s]: that of the hold, or the time of the cause that interrupted it; null "
        "without one"
    )
    rest_from_s: float | None = Field(
        description="Time from which on the force is at rest in it [s]; null where it is not"
    )
    hold_ratio: float | None = Field(
        description="Mean of F_m/(α_f F_s) in the later half of its rest; null where the tip does not press then"
    )
    frequency_hz: float | None = Field(
        default=None,
        description="Frequency of a swing that is judged instead of a hold, where a person is the hand [1/s]; null in "
        "a hold",
    )
    coupled_share: float = Field(
        default=1.0,
        description="Share of the hold in which hand and tip were coupled: both sent samples, the motor of the hand "
        "was on, and the tip followed, 0..1; a hold with less than half is `guarded` unless its motion shows more",
    )


class InterruptionSummary(_Part):
    """A time in which the loop was open, or a process was away."""

    kind: InterruptionKind = Field(
        description="`process_ended`; `source_silent`: hand or AFM sent nothing for more than 0.05 s, and no message "
        "is missing; `tip_held`: the tip was held because no command came; `hand_let_go`: the motor of the hand was off"
    )
    start_s: float = Field(description="Start in the session [s]")
    end_s: float = Field(
        description="End in the session [s]; where the hand's process ended, when its force profile began "
        "again, or else "
        "the end of the session; of another process that ended the same as `start_s`"
    )
    reason: str = Field(description="Report of the device or the launcher about it")


class OutsideSummary(_Part):
    """A warning that the session was outside of the conditions in which its law was shown to hold."""

    time_s: float = Field(description="Time of the warning in the session [s]")
    law: str = Field(description="Law that was in force")
    axis: Literal["line", "stiffness", "drift", "together"] = Field(
        description="Quantity by which the session was outside; `together`: each was shown with others, but not with "
        "one another"
    )
    text: str = Field(description="The finding, its meaning and the remedy")


class FeltOutsideSummary(_Part):
    """A time in which the hand felt more than 1.5 times, or less than 0.6 times, the true stiffness."""

    from_s: float = Field(description="Start in the session [s]")
    to_s: float = Field(description="End in the session [s]")
    ratio: float = Field(description="Ratio of the felt to the true stiffness, median of the time")
    low: float = Field(description="Lower end of the interval of `ratio`")
    high: float = Field(description="Upper end of the interval of `ratio`")
    text: str = Field(description="The same in words")


class FeltSummary(_Part):
    """Ratio of the felt to the true stiffness, or the reason why it cannot be known."""

    ratio: float | None = Field(
        description="Ratio of the stiffness that the hand felt, while it moved to and fro in contact, to the true "
        "one: the median of windows of 10 s, of those in `outside` where there are any; null where it cannot be known"
    )
    low: float | None = Field(description="Lower end of the interval of 95 % of `ratio`")
    high: float | None = Field(description="Upper end of the interval of 95 % of `ratio`")
    felt_n_per_m: float | None = Field(description="Stiffness that the hand felt [N/m]")
    there_n_per_m: float | None = Field(description="True stiffness, at the hand's scale [N/m]")
    reason: str = Field(description="The felt stiffness in words, or the reason why it cannot be known")
    outside: list[FeltOutsideSummary] = Field(
        default=[],
        description="Times in which the hand felt more than 1.5 or less than 0.6 of the true stiffness; the key is "
        "absent where it never did",
    )


class OtherReading(_Part):
    """The figures of the other reading of the clocks."""

    stable: bool | None = Field(description=f"`stable` of the session, {_TAKEN_OFF}")
    verdict: Kind = Field(description=f"`verdict` of the session, {_TAKEN_OFF}")
    reason: str = Field(description=f"`reason` of the session, {_TAKEN_OFF}")
    hold_ratio: float | None = Field(description=f"`hold_ratio` of the session, {_TAKEN_OFF}")


class ClocksSummary(_Part):
    """Difference between the clocks of the two sites, as the link measured it."""

    offset_s: float | None = Field(
        description="Time by which the slave's clock is ahead, in the middle of the recording [s]; null where a clock "
        "was set within it, because there is no single offset"
    )
    uncertainty_s: float = Field(
        description="Bound of the error of the offset [s]: half of the best round trip; the greatest one where a clock "
        "was set"
    )
    drift_ppm: float = Field(description="Time that the slave's clock gains on the master's [ppm]")
    applied: bool = Field(description="Whether the clocks are shown to differ, so that the difference is taken off")
    reason: str = Field(description="Reason why the difference is taken off or not, in words")
    otherwise: OtherReading | None = Field(
        description="The other reading, where it can be neither shown nor excluded; null where there is only one"
    )


class LineSummary(_Part):
    """Behaviour of one direction of the line between two sites while the session ran."""

    direction: str = Field(description="`forward`, from the master to the slave, or `backward`")
    queue_max_ms: float = Field(description="Longest standing queue in front of the line [ms]")
    queue_max_low_ms: float | None = Field(
        default=None,
        description="Lower end of the interval of `queue_max_ms` [ms]; null in older recordings, which have none",
    )
    queue_max_high_ms: float | None = Field(
        default=None, description="Upper end of the interval of `queue_max_ms` [ms]; null where the lower end is"
    )
    full_share: float = Field(description="Share of the time in which its sender took it for full, 0..1")
    capacity_mbit: float | None = Field(
        description="Capacity of the line, measured by a train of datagrams or while it was full [Mbit/s]; null if "
        "not measured"
    )
    capacity_low_mbit: float | None = Field(
        default=None, description="Lower end of the interval of `capacity_mbit` [Mbit/s]; null where that is"
    )
    capacity_high_mbit: float | None = Field(
        default=None,
        description="Upper end of the interval of `capacity_mbit` [Mbit/s]; null where that is, and where nothing "
        "bounds it",
    )
    datagrams_per_s: float = Field(
        description="Datagrams sent in a second [1/s]; fewer than 1000 where the line was full"
    )
    lost_share: float | None = Field(description="Share lost of the datagrams whose fate is known; null without any")
    blocked_s: list[list[float]] = Field(
        default=[],
        description="Intervals [s] in which UDP was blocked in this direction: its sender sent on, no datagram "
        "arrived, and TCP went on; a block that began before the session begins below 0",
    )


class LineStateSummary(_Part):
    """A time in which the line between two sites kept its round trip, from one lasting change to the next."""

    from_s: float = Field(description="Start in the session [s]")
    to_s: float = Field(description="End in the session [s]")
    round_trip_ms: float = Field(description="Least round trip of the line in it [ms]")
    low_ms: float = Field(description="Lower end of the interval of `round_trip_ms` [ms]")
    high_ms: float = Field(description="Upper end of the interval of `round_trip_ms` [ms]")


class IntervalsSummary(_Part):
    """Intervals of the figures that are means or percentiles of samples; null where a figure has too few of them."""

    hold_ratio: list[float] | None = Field(default=None, description="Interval of `hold_ratio`")
    contact_x_cm: list[float] | None = Field(default=None, description="Interval of `contact_x_cm` [cm]")
    release_force_nn: list[float] | None = Field(default=None, description="Interval of `release_force_nn` [nN]")
    loop_age_p50_ms: list[float] | None = Field(default=None, description="Interval of `loop_age_ms.p50` [ms]")
    loop_age_p99_ms: list[float] | None = Field(default=None, description="Interval of `loop_age_ms.p99` [ms]")


class PartSummary(_Part):
    """One of the files of a recording in parts."""

    file: str = Field(description="Name of the file, without its folder")
    begins_s: float = Field(description="First message of the file, in the time of the session [s]")
    ends_s: float = Field(description="Last message of the file, in the time of the session [s]")
    pause_s: float = Field(description="Time since the file before, in which nothing was recorded [s]")
    messages: int = Field(description="Messages in the file")


class RecordingSummary(_Part):
    """The account of the recording that the session was read from."""

    file: str = Field(description="Path of the recording, or of the first of its parts")
    complete: bool = Field(description="Whether the recorder has everything that was sent to it")
    missing: list[str] = Field(description="Missing parts, in sentences")
    lost: int = Field(description="Messages that are missing, without those that the impaired link dropped")
    messages: int = Field(description="Messages in the recording")
    odd: list[str] = Field(
        default=[],
        description="Oddities although nothing is missing, such as messages dated far from all others, in sentences; "
        "the key is absent without any",
    )
    parts: list[PartSummary] = Field(
        default=[], description="The files of a recording in parts; the key is absent where there is one file"
    )


class Summary(_Part):
    """The summary of a session, the content of `summary.json`."""

    scenario: str = Field(description="Name of the scenario")
    law: list[str] = Field(description="Laws that were in force, one after the other")
    parameters: dict[str, Any] = Field(description="Parameters of the law that the scenario names, SI units")
    changed: list[str] = Field(
        description="Parameters that were set while the session ran, each with the node that set it"
    )
    outside_of_shown: list[OutsideSummary] = Field(
        default=[],
        description="Warnings that the session was outside of the conditions in which the benchmark showed its law to "
        "hold (`docs/laws.md`); the key is absent where there was none",
    )
    link_round_trip_ms: float | None = Field(
        description="Median of the delays that the link added there and back [ms]; null without `link/status`"
    )
    link_round_trip_range_ms: list[float] | None = Field(
        default=None,
        description="Least and greatest of those delays, each a mean of 0.1 s [ms]: they differ where the delay was "
        "changed in the session; null without `link/status`",
    )
    loop_round_trip_ms: float | None = Field(
        default=None,
        description="Median age of the hand's sample that the newest answer descends from, in whole periods, as the "
        "law has to bridge it [ms]: the delay of the link and that of the rig itself; null without `law/status`",
    )
    link_profile: str = Field(
        description="Network of the scenario: its profile; `constant delay` or `custom` where keys make another one of "
        "`clean`, and as in `lte, changed` where they change another profile"
    )
    link_seed: int = Field(description="Seed of the random streams of the link")
    instrument: str = Field(
        description="Disturbances of the AFM: the name of its instrument, as in `real`, or `real, changed` where keys "
        "change it; `disturbed` without a name; the driver's name where it is not simulated"
    )
    plugins: dict[str, Package] = Field(
        description="Packages that contributed to the session, by `<kind>.<name>` of the contribution"
    )
    version: str = Field(description="Version of telenano that recorded the session; unknown if not recorded")
    commit: str = Field(description="Commit of telenano that recorded the session; unknown if not recorded")
    duration_s: float = Field(description="Duration of the operator's force profile as recorded [s]")
    stable: bool | None = Field(
        description="Whether the verdict is `stable`; null where it is `cannot_say` or `no_data`"
    )
    verdict: Kind = Field(description="Verdict on the session: that of its worst hold")
    reason: str = Field(description="The verdict in words")
    hold_ratio: float | None = Field(description="`hold_ratio` of the last hold that has one; null where none has")
    felt_stiffness: FeltSummary | None = Field(
        default=None, description="Ratio of the felt to the true stiffness (`docs/laws.md`)"
    )
    contact_x_cm: float | None = Field(
        description="Mean position reference of the hand in the last second of the session [cm]; null without "
        "`haptic/command`"
    )
    release_force_nn: float | None = Field(
        description="Mean force F_s on the tip in the last second of the session [nN]; null without `afm/state`"
    )
    greatest_pull_nn: Annotated[float | None, OfTip(("tip_force_n.2",), _greatest_pull_nn)] = Field(
        description="Most negative force F_s on the tip in the session, 0 if it was never pulled [nN]; null without "
        "`afm/state`"
    )
    tip_holds: int = Field(
        description="Number of times that the tip was held because no command came within the deadline "
        "(`command_deadline`)"
    )
    hand_let_go: int = Field(description="Number of times that the hand was let go while the session ran")
    processes_ended: int = Field(description="Number of processes of the rig that ended while the session ran")
    sources_silent: int = Field(
        default=0,
        description="Number of times that hand or AFM sent nothing for more than 0.05 s while no message was lost",
    )
    interruptions: list[InterruptionSummary] = Field(description="Each of these, in order of time")
    hand_cycles: int = Field(
        description="Number of times that the hand pressed harder and then less again, each way by a tenth of its "
        "greatest force and by 0.1 N: a law that loses some energy in each cycle may stand still after a hundred, "
        "which fewer do not show"
    )
    loop_age_ms: LoopAge | None = Field(
        description="Age of the first answer to each sample of the hand, on the hand's own clock; null if none came"
    )
    loop_age_parts_ms: dict[str, list[float]] = Field(
        default={},
        description="By part of the loop: its part of that age for the median sample, and for the slow one at 99 %; "
        "`whole` is their sum [ms]; the key is absent where fewer than 50 samples can be followed",
    )
    loop_age_largest: str = Field(default="", description="The largest part in words; absent where those are")
    intervals: IntervalsSummary = Field(
        description="The ends of the interval of 95 % of each figure that is estimated, from the scatter of its own "
        "samples; null where these do not say how well their mean is known, because a longer record would have slow "
        "parts that this one does not show (`telenano/analysis/mean_interval.py`); without the errors of calibrations"
    )
    overruns: int = Field(description="Deadlines that nodes missed while the session ran")
    rate_hz: dict[str, float] = Field(description="By channel: messages sent in a second of the session [1/s]")
    completeness: dict[str, float] = Field(
        description="By channel with one source and a declared rate: recorded share of the declared number of messages"
    )
    seq_gaps: dict[str, int] = Field(description="By channel: gaps in the numbers of the messages, in all files")
    contact_known: bool = Field(
        description="Whether the instrument measures when the tip touches; where it does not, as of a spring, a "
        "recorded map and a controller without h, the episodes are taken from the force"
    )
    holds: list[HoldSummary] = Field(description="The holds of the session, in order of time")
    clocks: ClocksSummary | None = Field(
        description="Difference between the clocks of the sites; null where the link measured nothing"
    )
    lines: list[LineSummary] = Field(
        default=[], description="Each direction of the line between two sites; the key is absent without one"
    )
    line_states: list[LineStateSummary] = Field(
        default=[],
        description="Round trip of the line between two sites before and after each lasting change; the key is absent "
        "without a line",
    )
    recording: RecordingSummary = Field(description="The account of the recording")


def tip_columns() -> tuple[str, ...]:
    """Return the columns of afm/state from which figures of the summary are computed."""
    return tuple(dict.fromkeys(name for figure in _figures_of_tip().values() for name in figure.columns))


def tip_figures(tip: Mapping[str, npt.NDArray[Any]]) -> dict[str, float | None]:
    """Return the figures computed from `tip`, the columns of afm/state in `tip_columns`, each of shape (n,)."""
    return {
        name: figure.value(*columns) if (columns := [tip[each] for each in figure.columns])[0].size else None
        for name, figure in _figures_of_tip().items()
    }


def _figures_of_tip() -> dict[str, OfTip]:
    return {
        name: part for name, field in Summary.model_fields.items() for part in field.metadata if isinstance(part, OfTip)
    }


def summary_schema() -> dict[str, Any]:
    """Return the JSON Schema of `summary.json`."""
    return {"$schema": _SCHEMA, **Summary.model_json_schema()}


def markdown() -> str:
    """Return the page docs/summary.md: a line for each key, those of parts under the key that holds them."""
    lines = [f"- `{name}` ({kind}): {meaning}" for name, kind, meaning in rows_of(summary_schema())]
    return "\n".join([_PAGE + lines[0], *lines[1:], ""])


def rows_of(schema: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return dotted name, type and meaning of each key of a JSON Schema, from the top down."""
    return list(_rows(schema, schema["$defs"], ""))


def _rows(part: dict[str, Any], parts: dict[str, Any], stem: str) -> Iterator[tuple[str, str, str]]:
    for key, value in part["properties"].items():
        name = stem + key
        yield name, _type_of(value), value["description"]
        for inner, place in _inside(value, name):
            yield from _rows(parts[inner["$ref"].rpartition("/")[2]], parts, place)


def _inside(value: dict[str, Any], name: str) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield the references in the type of a key, each with the prefix of the keys in that part."""
    if "$ref" in value:
        yield value, f"{name}."
    for choice in value.get("anyOf", ()):
        yield from _inside(choice, name)
    if "items" in value:
        yield from _inside(value["items"], f"{name}[]")
    if isinstance(value.get("additionalProperties"), dict):
        yield from _inside(value["additionalProperties"], f"{name}.<name>")


def _type_of(value: dict[str, Any]) -> str:
    """Return the type of a key in words."""
    if "anyOf" in value:
        return " or ".join(map(_type_of, value["anyOf"]))
    if "enum" in value:
        return "one of " + ", ".join(f"`{word}`" for word in value["enum"])
    if value.get("type") == "array":
        return f"list of {_type_of(value['items'])}"
    return _TYPES.get(value.get("type", "object"), "object")

"""`telenano push`: push one particle, in simulated time or with the instrument of a running rig."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.cli import (
    JsonOption,
    SiteFileOption,
    Void,
    print_document,
    progress,
    report_errors,
    rules,
    validated,
    with_options,
)
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import ConfigError, RigError
from telenano_lab.assembly.push_program import AT_GOAL, PushSettings
from telenano_lab.microscopy.program_view import LIVE_RULES, AfmOption, LiveOption, decided_by_rig, follow_program

if TYPE_CHECKING:
    from telenano.wire import Scalar

_REACH_M = 1e-3
_ENDS = ("x0_m", "y0_m", "x1_m", "y1_m")


@rules(
    *LIVE_RULES,
    decided_by_rig("--afm"),
    Void("--gain", "which it controls", unless="--hold force"),
    Void("--pitch", "whose lines it parts", unless="--mode sweep"),
)
@with_options(PushSettings, leave_out=_ENDS)
def push(
    begin: Annotated[
        str, typer.Option("--from", metavar="X,Y", help="Assumed place of the particle on the sample [nm].")
    ],
    goal: Annotated[str, typer.Option("--to", metavar="X,Y", help="Its target on the sample [nm].")],
    given: dict[str, Any],
    afm: AfmOption = None,
    live: LiveOption = False,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Push one particle with the tip from one place to another; print the forces felt, and its assumed place."""
    with report_errors(as_json):
        ends = (*_place("--from", begin), *_place("--to", goal))
        given |= dict(zip(_ENDS, ends, strict=True))
        validated(PushSettings, given, dict(zip(_ENDS, ("--from", "--from", "--to", "--to"), strict=True)))
        keys: dict[str, Scalar] = {"program": "push", **{f"push.{name}": value for name, value in given.items()}}
        document = _live(site_file, keys, as_json=as_json) if live else _simulated(keys, afm or [], as_json=as_json)
    document["error_m"] = math.dist(document["believed_m"], ends[2:])
    print_document(document, document["why"], as_json=as_json)


def _place(option: str, text: str) -> tuple[float, float]:
    """Parse the place [m] that an option names in nm; ConfigError if it is no pair or out of reach."""
    try:
        x, y = (1e-9 * float(word) for word in text.split(","))
    except ValueError as error:
        raise ConfigError(f"{option} {text}: must be two numbers in nm with a comma between, such as 1000,0") from error
    if not max(abs(x), abs(y)) <= _REACH_M:
        reach = f"{1e9 * _REACH_M:g} nm"
        raise ConfigError(f"{option} {text}: must lie within {reach} of the middle of the sample, both ways, in nm")
    return x, y


def _values(values: "Mapping[str, Scalar]") -> dict[str, Any]:
    """Return the values of a push, with its believed place as a pair."""
    document = dict(values)
    believed = document.pop("believed_x_m"), document.pop("believed_y_m")
    why = str(document.pop("why"))
    return {"why": why, "at_goal": why == AT_GOAL, "believed_m": believed, **document}


def _live(site_file: Path, keys: "dict[str, Scalar]", *, as_json: bool) -> dict[str, Any]:
    from telenano_lab.microscopy.image_files import LiveImage

    report = follow_program(site_file, keys, LiveImage(), as_json=as_json)
    if report.state != "finished" or report.values is None:
        raise RigError(report.text)
    return _values(report.values)


def _simulated(keys: "dict[str, Scalar]", overrides: list[str], *, as_json: bool) -> dict[str, Any]:
    """Push in simulated time a particle at its believed place, or those that --afm names."""
    from telenano.devices import VirtualInstrument
    from telenano_lab.assembly.particle_bench import DISTURBED, configured

    particles = {"places": [[keys["push.x0_m"], keys["push.y0_m"]]]}
    config = configured(overrides, particles, DISTURBED, "places", "count", "seed")
    instrument = VirtualInstrument(config)
    with progress("push", 1.0, shown=not as_json) as show:
        # A bar is drawn at most ten times a second, and a step takes a tenth of a millisecond.
        for number, _ in enumerate(instrument.run(keys)):
            if number % 1000 == 0 and (report := instrument.report()) is not None:
                show(0.01 * report.done_percent, text=report.text)
    outcome = instrument.outcome
    if outcome is None or outcome.values is None or outcome.state != "finished":
        raise ConfigError("--from: nothing was pushed: check that place" if outcome is None else outcome.text)
    places = instrument.truths["particles"].places_m.tolist()
    outcome_values = _values(outcome.values)
    # Only a simulation knows the true place.
    return {**outcome_values, "true_m": min(places, key=lambda place: math.dist(place, outcome_values["believed_m"]))}

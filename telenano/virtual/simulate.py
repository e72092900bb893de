"""The function `telenano.simulate`: a session in lockstep, or of real nodes in virtual time with a recording.

    soft = simulate("fig12", law="wave", round_trip_ms=40.0)
    recording = simulate("fig12", law="wave", round_trip_ms=40.0, recording="out/wave", seed=7)

The first call returns only the series of the session; the second also makes a recording, as `telenano up` does.
"""

import inspect
import json
import math
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from datetime import datetime
from functools import wraps
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, overload

from telenano.settings.config import nested
from telenano.wire.errors import ConfigError, LockstepError, RigError, named_by, probably_meant

if TYPE_CHECKING:
    from telenano.analysis.session import Session
    from telenano.api import RecordedSession


Given = ParamSpec("Given")
Result = TypeVar("Result")


def _abouts(function: Callable[..., object]) -> dict[str, str]:
    """Return the first line on each argument in the docstring of a function."""
    text = inspect.cleandoc(function.__doc__ or "").replace("\n    ", "\n        ")
    names = inspect.signature(function).parameters
    return {name: about for name, about in re.findall(r"^ {8}(\w+): (.*)$", text, re.M) if name in names}


def _says_what_is_meant(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Return the function with a TypeError that suggests the intended argument for an unknown one."""
    signature = inspect.signature(function)

    @wraps(function)
    def called(*args: Given.args, **given: Given.kwargs) -> Result:
        check_arguments(given)
        positional = [one.name for one in signature.parameters.values() if one.kind is one.POSITIONAL_OR_KEYWORD]
        if len(args) > len(positional):
            raise TypeError(
                f"telenano.simulate: {args[len(positional)]!r} has no name: all but {', '.join(positional)} are given"
                f" by name, as in law='wave'; there are {', '.join(signature.parameters)}"
            )
        return function(*args, **given)

    return called


def _wrong_argument(name: str, value: object, abouts: Mapping[str, str]) -> str:
    """Return a message on an unknown argument, which suggests another argument or a key of the scenario."""
    text = f"has no argument {name!r}"
    # The description of settings contains a key as an example, which is not an argument.
    if meant := named_by(name, {each: text for each, text in abouts.items() if each != "settings"}):
        return f"{text}; did you mean {' or '.join(meant)}? There are {', '.join(abouts)}"
    if near := probably_meant(name, abouts):
        return f"{text}{near} There are {', '.join(abouts)}"
    from telenano.launcher.scenario_keys import keys_named

    if keys := keys_named(name):
        return f"{text}; a key of the scenario is given by settings={{{keys[0]!r}: {value!r}}}" + (
            f", and others of this name are {', '.join(keys[1:5])}" if keys[1:] else ""
        )
    return f"{text}; there are {', '.join(abouts)}, and settings takes every key that `telenano param list` has"


@overload
def simulate(
    scenario: str | os.PathLike[str] = ...,
    *,
    law: str | None = ...,
    round_trip_ms: float | None = ...,
    environment: str | None = ...,
    instrument: str | None = ...,
    operator: Mapping[str, object] | None = ...,
    duration_s: float | None = ...,
    settings: Mapping[str, object] | None = ...,
    recording: None = None,
    seed: int | None = ...,
    report: bool = ...,
) -> "Session": ...


@overload
def simulate(
    scenario: str | os.PathLike[str] = ...,
    *,
    law: str | None = ...,
    round_trip_ms: float | None = ...,
    environment: str | None = ...,
    instrument: str | None = ...,
    operator: Mapping[str, object] | None = ...,
    duration_s: float | None = ...,
    settings: Mapping[str, object] | None = ...,
    recording: str | os.PathLike[str],
    seed: int | None = ...,
    report: bool = ...,
) -> "RecordedSession": ...


@_says_what_is_meant
def simulate(
    scenario: str | os.PathLike[str] = "fig12",
    *,
    law: str | None = None,
    round_trip_ms: float | None = None,
    environment: str | None = None,
    instrument: str | None = None,
    operator: Mapping[str, object] | None = None,
    duration_s: float | None = None,
    settings: Mapping[str, object] | None = None,
    recording: str | os.PathLike[str] | None = None,
    seed: int | None = None,
    report: bool = True,
) -> "Session":
    """Run a scenario without a rig: in lockstep, or with a recording by the real nodes in virtual time.

    In lockstep it runs as plain Python, a second for the eight of Fig. 12. A loop of some twenty such calls compiles
    the models, which takes some ten seconds, is said, and is kept for later processes (docs/api.md). A scenario that a
    lockstep has no model for, such as one whose tip is moved by a program, is run as with `recording`, in a new folder
    sessions/NAME-DATE-TIME; a warning says so.

    With `recording` it runs the nodes of both sites, the link and the recorder on a bus in memory, and returns the
    recording, which is the same to the bit for the same seed, on any processor.

    Args:
        scenario: A known name or a YAML file; it applies where no other argument is given.
        law: The name of a law.
        round_trip_ms: The round trip (RTT) of the link [ms]: its delay, or latency, half of it each way.
        environment: The sample, as `afm_node.environment`.
        instrument: The disturbances of the AFM: ideal, real or real_drifting.
        operator: The hand, as the section `haptic_node.operator`.
        duration_s: The length of the session [s].
        settings: Values by dotted key of the scenario, such as {"controller.virtual_impedance.force_gain": 10}.
        recording: The folder for session.mcap, figure and summary, which must not hold a session; None records nothing.
        seed: The seed of all that is random in the session; None leaves those of the scenario as they are.
        report: Whether figure and summary are written beside the recording.

    Returns:
        The `SimulatedSession` in lockstep, or the `RecordedSession`; both are a `Session`.

    Raises:
        ConfigError: Names the file or key at fault, or what cannot be simulated.
        RigError: The recorded session failed; the message has the reason.
    """
    if settings is not None and not isinstance(settings, Mapping):
        raise ConfigError(
            f"settings is a {type(settings).__name__}: give values by dotted key, {{'controller.law': 'wave'}}"
        )
    for name, number in (("round_trip_ms", round_trip_ms), ("duration_s", duration_s)):
        is_number = isinstance(number, Real) and not isinstance(number, bool)
        if number is not None and not (is_number and math.isfinite(number)):
            unit = "milliseconds" if name.endswith("_ms") else "seconds"
            raise ConfigError(f"{name}: must be a number of {unit}, got {number!r}")
    if seed is not None and not (isinstance(seed, Integral) and 0 <= seed < 2**31):
        raise ConfigError(f"seed: must be a whole number from 0 to {2**31 - 1}, got {seed!r}")
    refused = None
    if recording is None:
        from telenano.lockstep.simulation import simulate_scenario

        try:
            return simulate_scenario(
                scenario,
                law=law,
                round_trip_ms=round_trip_ms,
                environment=environment,
                instrument=instrument,
                operator=operator,
                duration_s=duration_s,
                settings=settings,
                seed=seed,
            )
        except LockstepError as error:
            refused = error
    # Imported here, because a session in lockstep needs neither these modules nor their requirements.
    from telenano.api import RecordedSession
    from telenano.launcher.run import report_of, reserved_folder
    from telenano.virtual.request import SimulateRequest, plan_of, run_plan

    flags = [f"controller.law={law}"] if law is not None else []
    flags += [f"afm_node.environment={environment}"] if environment is not None else []
    flags += [f"haptic_node.operator={json.dumps(dict(operator))}"] if operator is not None else []
    flags += list(_flags(nested(dict(settings or {}), "settings")))
    folder = nullcontext(Path(recording)) if recording else reserved_folder(os.fspath(scenario), datetime.now())
    with folder as out:
        request = SimulateRequest(
            scenario=os.fspath(scenario),
            instrument=instrument,
            round_trip_ms=None if round_trip_ms is None else float(round_trip_ms),
            duration_s=None if duration_s is None else float(duration_s),
            out=out,
            settings=tuple(flags),
            seed=None if seed is None else int(seed),
        )
        plan = plan_of(request, out)
        if refused is not None:
            warnings.warn(f"{refused}; the nodes run it in virtual time instead, and record {out}", stacklevel=3)
        outcome = run_plan(plan, request)
    if outcome.failure or not outcome.recordings:
        raise RigError(outcome.failure or "; ".join(outcome.missing) or "the session left no recording")
    if report:
        report_of(outcome, plan, lambda text: None)
    return RecordedSession(outcome.recordings)


def check_arguments(given: Mapping[str, object]) -> None:
    """Raise TypeError, with the name that was probably meant, for the first of some names that `simulate` lacks."""
    abouts = _abouts(simulate)
    for name, value in given.items():
        if name not in abouts:
            raise TypeError(f"telenano.simulate: {_wrong_argument(name, value, abouts)}")


def _flags(tree: Mapping[str, Any], stem: str = "") -> Iterator[str]:
    """Yield nested settings as dotted flags, as on a command line."""
    for key, value in tree.items():
        name = f"{stem}{key}"
        if isinstance(value, Mapping):
            yield from _flags(value, f"{name}.")
        else:
            yield f"{name}={json.dumps(value)}"

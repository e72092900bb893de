"""`telenano.simulate`: a session in lockstep, or one of the real nodes in virtual time, with its recording.

    soft = simulate("fig12", law="wave", round_trip_ms=40.0)
    recording = simulate("fig12", law="wave", round_trip_ms=40.0, recording="out/wave", seed=7)

The first keeps the course alone; the second is a recording as `telenano up` leaves one.
"""

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from telenano.settings.config import nested
from telenano.wire.errors import ConfigError, RigError

if TYPE_CHECKING:
    from telenano.api import RecordedSession
    from telenano.lockstep.simulation import SimulatedSession


@overload
def simulate(
    scenario: str = ...,
    *,
    law: str | None = ...,
    round_trip_ms: float | None = ...,
    environment: str | None = ...,
    instrument: str | None = ...,
    operator: Mapping[str, object] | None = ...,
    duration_s: float | None = ...,
    settings: Mapping[str, object] | None = ...,
    recording: None = None,
) -> "SimulatedSession": ...


@overload
def simulate(
    scenario: str = ...,
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


def simulate(
    scenario: str = "fig12",
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
) -> "SimulatedSession | RecordedSession":
    """Run a scenario without processes: in lockstep, or with a recording by the real nodes in virtual time.

    In lockstep it runs as plain Python, a second for the eight of Fig. 12. A loop of some twenty such calls compiles
    the models, which takes some ten seconds, is said, and is kept for later processes (docs/api.md).

    With `recording` it runs the nodes of both sites, the link and the recorder on a bus in memory, and returns the
    recording, which is the same to the bit for the same seed, on any processor.

    Args:
        scenario: A known name or a YAML file. What the other arguments leave out is as in it.
        law: The name of a law.
        round_trip_ms: The round trip of the link [ms], half of it each way.
        environment: The sample, as `afm_node.environment`.
        instrument: What disturbs the AFM: ideal, real or real_drifting.
        operator: The hand, as the section `haptic_node.operator`.
        duration_s: The length of the session [s].
        settings: Values by dotted key of the scenario, such as {"controller.virtual_impedance.force_gain": 10}.
        recording: The folder for session.mcap, figure and summary, which must not hold a session; None records nothing.
        seed: The seed of all that is random in a recorded session; None leaves those of the scenario as they are.
        report: Whether figure and summary are written beside the recording.

    Returns:
        The session in lockstep, or the recording.

    Raises:
        ConfigError: Names the file or key at fault, or what cannot be simulated.
        RigError: The recorded session failed; the message has the reason.
    """
    if settings is not None and not isinstance(settings, Mapping):
        raise ConfigError(
            f"settings is a {type(settings).__name__}: give values by dotted key, {{'controller.law': 'wave'}}"
        )
    if recording is None:
        if seed is not None:
            raise ConfigError("seed: a session in lockstep has those of its scenario: give `recording` as well")
        from telenano.lockstep.simulation import simulate_scenario

        return simulate_scenario(
            scenario,
            law=law,
            round_trip_ms=round_trip_ms,
            environment=environment,
            instrument=instrument,
            operator=operator,
            duration_s=duration_s,
            settings=settings,
        )
    # A session in lockstep needs neither these nor the system that they need.
    from telenano.api import RecordedSession
    from telenano.launcher.run import report_of
    from telenano.virtual.request import SimulateRequest, plan_of, run_plan

    flags = [f"controller.law={law}"] if law is not None else []
    flags += [f"afm_node.environment={environment}"] if environment is not None else []
    flags += [f"haptic_node.operator={json.dumps(dict(operator))}"] if operator is not None else []
    flags += list(_flags(nested(dict(settings or {}), "settings")))
    request = SimulateRequest(
        scenario=scenario,
        instrument=instrument,
        round_trip_ms=round_trip_ms,
        duration_s=duration_s,
        out=Path(recording),
        settings=tuple(flags),
        seed=seed,
    )
    plan = plan_of(request, Path(recording))
    outcome = run_plan(plan, request)
    if outcome.failure or not outcome.recordings:
        raise RigError(outcome.failure or "; ".join(outcome.missing) or "the session left no recording")
    if report:
        report_of(outcome, plan, lambda text: None)
    return RecordedSession(outcome.recordings)


simulate.__qualname__ = "telenano.simulate"


def _flags(tree: Mapping[str, Any], stem: str = "") -> Iterator[str]:
    """Yield settings as the dotted flags that a person would give."""
    for key, value in tree.items():
        name = f"{stem}{key}"
        if isinstance(value, Mapping):
            yield from _flags(value, f"{name}.")
        else:
            yield f"{name}={json.dumps(value)}"

"""Sessions in simulated time of which it is known what the hand feels: drawn law, sample, instrument, line and hand."""

import math
import random
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

import telenano

LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "model_mediated", "smith")
LENGTH_S = 14.0
_STEP_S = 0.02
_BEGINS_S = 2.0


class MadeSession(NamedTuple):
    """A session and what it was drawn with; ratio: what the hand feels over what is there."""

    seed: int
    kind: str
    law: str
    instrument: str
    stiffness_n_per_m: float
    frequency_hz: float
    session: Any
    ratio: float


def made_session(seed: int) -> MadeSession:
    """Draw a session: the hand swings as in the table of felt stiffness, or stands, trembles or presses in steps."""
    draw = random.Random(f"felt session {seed}")
    law, instrument = draw.choice(LAWS), draw.choice(("ideal", "real"))
    stiffness = math.exp(draw.uniform(math.log(8.0), math.log(80.0)))
    # Half of the sessions of laws that a delay makes unstable are run without one.
    trip_ms = draw.choice((0.0, 0.0, draw.uniform(5.0, 40.0), draw.uniform(40.0, 150.0)))
    kind = draw.choice(("swings", "swings", "swings", "swings", "stands", "trembles", "steps"))
    frequency_hz = draw.uniform(0.3, 2.0) if kind == "swings" else draw.uniform(7.0, 12.0)
    mean_n = draw.uniform(0.8, 1.3)
    amplitude_n = {"swings": draw.uniform(0.2, 0.45), "trembles": draw.uniform(0.02, 0.1)}.get(kind, 0.0)
    levels = [mean_n * draw.uniform(0.7, 1.3) for _ in range(3)] if kind == "steps" else [mean_n]
    points = list(_corners(levels, amplitude_n, frequency_hz))
    session = telenano.simulate(
        "fig12",
        law=law,
        instrument=instrument,
        round_trip_ms=trip_ms,
        environment="spring",
        operator={"kind": "force_profile", "points": points},
        duration_s=LENGTH_S,
        settings={
            "afm_node.spring.stiffness_n_per_m": stiffness,
            "afm_node.safety.retract_position_m": 0.0,
            "afm_node.disturbances.seed": seed,
        },
    )
    ratio = (_felt if kind == "swings" else _held)(session, frequency_hz, stiffness)
    return MadeSession(seed, kind, law, instrument, stiffness, frequency_hz, session, ratio)


def _corners(levels: list[float], amplitude_n: float, frequency_hz: float) -> Iterator[dict[str, float]]:
    yield {"time_s": 0.0, "force_n": 0.0}
    yield {"time_s": 0.5, "force_n": levels[0]}
    each_s = (LENGTH_S - _BEGINS_S) / len(levels)
    for place in range(round((LENGTH_S - _BEGINS_S) / _STEP_S)):
        since = place * _STEP_S
        level = levels[min(int(since / each_s), len(levels) - 1)]
        yield {
            "time_s": _BEGINS_S + since,
            "force_n": level + amplitude_n * math.sin(2.0 * math.pi * frequency_hz * since),
        }


def _felt(session: Any, frequency_hz: float, stiffness: float) -> float:
    """Return Re(F_m / X_m) of the swing over alpha_f alpha_p K, from the last whole periods, beside a trend."""
    time_s = session["time_s"]
    whole = math.floor((LENGTH_S - _BEGINS_S - 2.0) * frequency_hz)
    part = time_s > LENGTH_S - whole / frequency_hz
    at = time_s[part]
    omega, off = 2.0 * math.pi * frequency_hz, at - at.mean()
    columns = np.stack([np.cos(omega * at), np.sin(omega * at), np.ones_like(off), off, off * off], axis=1)
    (force, way) = (
        complex(*np.linalg.lstsq(columns, session[name][part], rcond=None)[0][:2])
        for name in ("operator_force_n", "hand_position_m")
    )
    scales: dict[str, Any] = session.conditions.parameters
    return (force / way).real / (scales["force_scale"] * scales["position_scale"] * stiffness)


def _held(session: Any, frequency_hz: float, stiffness: float) -> float:
    """Return force over way at the end over alpha_f alpha_p K: hand and spring are at rest at 0."""
    late = session["time_s"] > LENGTH_S - 2.0
    scales: dict[str, Any] = session.conditions.parameters
    secant = float(session["operator_force_n"][late].mean() / session["hand_position_m"][late].mean())
    return secant / (scales["force_scale"] * scales["position_scale"] * stiffness)

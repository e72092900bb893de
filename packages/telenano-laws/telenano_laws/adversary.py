"""Random draws that try to violate the energy bound of a law: `python -m telenano_laws.adversary`.

A draw has a line (delays, jitter, losses in bursts, outages that drop or hold, repeated messages), a sample (a spring
that also pulls, a wall, or tip and sample of the paper with another cantilever stiffness, which may drift), a hand (a
force profile, or an arm of any stiffness moving along a path) and, for `bounded_model`, wrong parameters of the model:
first stiffness, memory, rate and lag terms. The number of the draw determines everything.

The energies judged are the sums of docs/passivity.md, "Passivity in discrete time": the force held over each step of
the hand's reference, and the trapezoidal rule at the tip.
"""

import argparse
import json
import math
import random
import sys
from typing import Any, NamedTuple

import numpy as np

import telenano

LAW = "bounded_model"
# Stiffest sample that the law tolerates over a line that loses signals, as most drawn lines do [N/m].
STIFFEST_N_PER_M = 175.0
# Length of an ordinary draw.
_SHORT_S = 20.0
# Length of the long draws, whose number is the option --hours.
_HOUR_S = 3600.0


class JudgedDraw(NamedTuple):
    """Number, verdict and settings of a draw, least energies and greatest forces.

    least_j, least_at_device_j: least energy at the law's ports, and with the hand's work counted at its device [J];
    pressed_n: greatest force of the tip, at the hand's scale [N]; hand_n: greatest magnitude of the hand's force [N].
    """

    number: int
    least_j: float
    least_at_device_j: float
    pressed_n: float
    hand_n: float
    verdict: str
    settings: dict[str, Any]


def drawn(number: int, law: str = LAW, duration_s: float = _SHORT_S) -> dict[str, Any]:
    """Return the scenario settings of a draw, by dotted key; the same number gives the same settings."""
    rng = random.Random(f"adversary {number}")
    settings: dict[str, Any] = {"delay_node.seed": number, "delay_node.profile": "clean"}
    for way in ("forward", "backward"):
        settings |= {f"delay_node.{way}.{key}": value for key, value in _line(rng).items()}
    settings |= _sample(rng)
    settings["haptic_node.operator"] = _hand(rng, duration_s)
    if law == LAW:
        settings |= {f"controller.{law}.{key}": value for key, value in _model(rng).items()}
    return settings


def _log(rng: random.Random, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _line(rng: random.Random) -> dict[str, Any]:
    delay_s = rng.choice((0.0, _log(rng, 1e-3, 0.3)))
    line: dict[str, Any] = {"delay_s": delay_s}
    if rng.random() < 0.5:
        line["jitter.distribution"] = rng.choice(("uniform", "normal", "pareto"))
        line["jitter.scale_s"] = _log(rng, 1e-4, 0.05)
        line["jitter.correlation"] = rng.choice((0.0, 0.9, 0.99))
    if rng.random() < 0.5:
        line["gilbert_elliott.p"] = _log(rng, 1e-4, 0.3)
        line["gilbert_elliott.r"] = _log(rng, 0.01, 1.0)
    if rng.random() < 0.3:
        line["outage.mean_up_s"] = _log(rng, 0.3, 10.0)
        line["outage.mean_down_s"] = _log(rng, 0.01, 0.3)
        line["outage.mode"] = rng.choice(("drop", "hold"))
    if rng.random() < 0.2:
        line["duplication.probability"] = rng.uniform(0.01, 0.5)
    return line


def _sample(rng: random.Random) -> dict[str, Any]:
    kind = rng.choice(("spring", "wall", "contact"))
    if kind == "contact":
        sample = {"afm_node.environment": "tip_sample", "afm_node.cantilever.stiffness_n_per_m": _log(rng, 5.0, 80.0)}
        if rng.random() < 0.3:
            sample["afm_node.disturbances.drift.enabled"] = True
            sample["afm_node.disturbances.drift.speed_m_per_s"] = rng.uniform(-2e-10, 2e-10)
        return sample
    return {
        "afm_node.environment": "spring",
        "afm_node.spring.stiffness_n_per_m": _log(rng, 0.3, STIFFEST_N_PER_M),
        "afm_node.spring.bilateral": kind == "spring",
        "afm_node.spring.rest_position_m": 0.0 if kind == "spring" else rng.uniform(0.0, 5e-9),
    }


def _hand(rng: random.Random, duration_s: float) -> dict[str, Any]:
    times, time_s = [], 0.2
    while time_s < min(duration_s, 600.0):
        times.append(time_s)
        time_s += _log(rng, 0.02, 3.0)
    if rng.random() < 0.5:
        forces = [rng.choice((0.0, rng.uniform(-1.0, 3.0))) for _ in times]
        points = [{"time_s": time, "force_n": force} for time, force in zip(times, forces, strict=True)]
        return {"kind": "force_profile", "points": points}
    stiffness = _log(rng, 20.0, 3000.0)
    path = [{"time_s": time, "position_m": rng.uniform(-2e-3, 5e-3 + 1.0 / stiffness)} for time in times]
    arm = {"damping_n_s_per_m": _log(rng, 1.0, 30.0), "mass_kg": _log(rng, 0.05, 1.0)}
    return {"kind": "impedance", "path": path, "stiffness_n_per_m": stiffness, **arm}


def _model(rng: random.Random) -> dict[str, float]:
    return {
        "first_stiffness_n_per_m": _log(rng, 10.0, 1e5),
        "memory_m": _log(rng, 1e-11, 3e-9),
        "update_s": _log(rng, 1e-3, 1.0),
        "update_force_n_per_s": _log(rng, 1.0, 1e3),
        "update_margin_n": rng.uniform(0.0, 5.0),
        "lag_damping": rng.uniform(0.0, 2.0),
        "lag_inertia": rng.uniform(0.0, 1.0),
    }


def judged(number: int, law: str = LAW, duration_s: float = _SHORT_S) -> JudgedDraw:
    """Run a draw in lockstep for `duration_s` [s], and return its result."""
    settings = drawn(number, law, duration_s)
    operator = settings.pop("haptic_node.operator")
    session = telenano.simulate(law=law, operator=operator, duration_s=duration_s, settings=settings)
    scale = session.conditions.parameters["position_scale"]
    tip_m, tip_n = session["base_position_m"] / scale, session["scaled_tip_force_n"]
    hand_n, hand_m, reference_m = session["operator_force_n"], session["hand_position_m"], session["reference_m"]
    tip_j = np.concatenate([[0.0], np.cumsum(0.5 * (tip_n[1:] + tip_n[:-1]) * np.diff(tip_m))])
    law_j = np.concatenate([[0.0], np.cumsum(hand_n[1:] * np.diff(reference_m))])
    device_j = np.concatenate([[0.0], np.cumsum(0.5 * (hand_n[1:] + hand_n[:-1]) * np.diff(hand_m))])
    return JudgedDraw(
        number,
        float((law_j - tip_j).min()),
        float((device_j - tip_j).min()),
        float(tip_n.max()),
        float(np.abs(hand_n).max()),
        session.verdict,
        settings,
    )


def main() -> None:
    """Run draws, one line of JSON each, and say which were the worst."""
    parser = argparse.ArgumentParser(prog="python -m telenano_laws.adversary", description=main.__doc__)
    parser.add_argument("--law", default=LAW, help="law to try (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first draw (default: %(default)s)")
    parser.add_argument("--draws", type=int, default=300, help="how many draws (default: %(default)s)")
    parser.add_argument("--hours", type=int, default=0, help="how many of them last an hour (default: %(default)s)")
    options = parser.parse_args()
    draws = []
    for number in range(options.first, options.first + options.draws):
        lasts_s = _HOUR_S if number - options.first < options.hours else _SHORT_S
        draws.append(judged(number, options.law, lasts_s))
        sys.stdout.write(json.dumps(draws[-1]._asdict()) + "\n")
        sys.stdout.flush()
    worst = sorted(draws, key=lambda one: one.least_j)[:5]
    energies = ", ".join(f"draw {one.number}: {1e3 * one.least_j:.4g} mJ" for one in worst)
    sys.stderr.write(f"{len(draws)} draws of {options.law}; least energy at the ports: {energies}\n")


if __name__ == "__main__":
    main()

"""Verdicts over outages: each law with each gain, on the spring, with an outage at many places of a hold.

    python packages/telenano-studies/tests/verdict_sweep.py [--every 0.01]

The theory says of each loop whether it is stable (`telenano_studies.loops.theory`): no outage may make a stable loop
one that cycles or grows, and none may make an unstable one stable. A row a loop: how often which verdict.
"""

import argparse
import sys
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from telenano_studies.loops.theory import critical_link_delay_s, loop_model

import telenano
from services.controller.config import ControllerConfig

STIFFNESS_N_PER_M = 20.0
HOLD_S = (0.9, 2.4)
OUTAGES_S = (0.03, 0.12, 0.2)
# a round trip [ms]: half of what the paper's gain bears on the spring, and one and a half times as much
ROUND_TRIPS_MS = (20.0, 65.0)
GAINS = (5.0, 12.0, 20.0)
LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "model_mediated")
# the simulation is at rest for so long, and for so many round trips, before the session begins
SETTLE_S, SETTLE_ROUND_TRIPS = 0.3, 4.0


class Loop(NamedTuple):
    """A law with a gain, None where it has none, at a round trip [ms], and whether theory says that it is stable."""

    law: str
    gain: float | None
    round_trip_ms: float
    is_stable: bool


def loops() -> list[Loop]:
    """Return the loops of the sweep; laws without a linear loop are passive and stable at any delay."""
    found = []
    for law in LAWS:
        for gain in GAINS if law == "virtual_impedance" else (None,):
            for round_trip_ms in ROUND_TRIPS_MS:
                stable = round_trip_ms < _edge_ms(law, gain)
                found.append(Loop(law, gain, round_trip_ms, stable))
    return found


def _edge_ms(law: str, gain: float | None) -> float:
    section: dict[str, Any] = {"law": law, law: {} if gain is None else {"force_gain": gain}}
    controller = ControllerConfig.model_validate(section)
    model = loop_model(law, controller.law_config(), STIFFNESS_N_PER_M)
    return float("inf") if model is None else 1e3 * critical_link_delay_s(model, controller.period_s)


def hold_after(loop: Loop, outage_s: float, at_s: float) -> Any:
    """Return the hold of a session with one outage of both ways, at a time of the session [s]."""
    start_s = at_s + SETTLE_S + SETTLE_ROUND_TRIPS * 1e-3 * loop.round_trip_ms
    settings: dict[str, Any] = {
        f"delay_node.{way}.outage.schedule": [[start_s, outage_s]] for way in ("forward", "backward")
    }
    if loop.gain is not None:
        settings[f"controller.{loop.law}.force_gain"] = loop.gain
    settings["afm_node.spring.stiffness_n_per_m"] = STIFFNESS_N_PER_M
    points = [(0.5, 0.0), (HOLD_S[0], 1.0), (HOLD_S[1], 1.0), (HOLD_S[1] + 0.1, 0.0)]
    operator = {"kind": "force_profile", "points": [{"time_s": t, "force_n": f} for t, f in points]}
    session = telenano.simulate(
        law=loop.law, round_trip_ms=loop.round_trip_ms, environment="spring", operator=operator,
        duration_s=HOLD_S[1] + 0.2, settings=settings,
    )  # fmt: skip
    return session.holds[0]


def wrong(loop: Loop, kind: str) -> bool:
    """Return whether a verdict contradicts the theory."""
    return kind in (("diverged", "limit_cycle") if loop.is_stable else ("stable",))


def sweep(every_s: float) -> dict[tuple[Loop, float], Counter[str]]:
    """Return how often which verdict, by loop and length of the outage [s], with one at each step [s] of the hold."""
    found = {}
    for loop in loops():
        for outage_s in OUTAGES_S:
            places = np.arange(HOLD_S[0], HOLD_S[1], every_s).tolist()
            found[loop, outage_s] = Counter(hold_after(loop, outage_s, at_s).verdict for at_s in places)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=float, default=0.01, help="distance of the places of the outage [s]")
    found = sweep(parser.parse_args().every)
    for (loop, outage_s), kinds in found.items():
        gain = "" if loop.gain is None else f", K_f {loop.gain:g}"
        says = "stable" if loop.is_stable else "unstable"
        words = f"{loop.law}{gain}, {loop.round_trip_ms:g} ms ({says}), outage {1e3 * outage_s:g} ms"
        sys.stdout.write(f"{words}: {dict(kinds)}\n")
    errors = sum(count for (loop, _), kinds in found.items() for kind, count in kinds.items() if wrong(loop, kind))
    sys.stdout.write(f"{errors} of {sum(map(Counter.total, found.values()))} verdicts contradict the theory\n")
    return int(errors > 0)


if __name__ == "__main__":
    sys.exit(main())

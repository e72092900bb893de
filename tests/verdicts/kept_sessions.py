"""What the judge says of sessions of the product, kept beside the size of their motion without the judge.

`python tests/verdicts/kept_sessions.py` runs them and writes `kept_sessions.json` again; read the difference before you
commit it. Each session is of a law over a line on a spring of 20 or 80 N/m: the hand presses with 1 N for 5 s.
"""

import json
import sys
import warnings
from collections import Counter
from itertools import pairwise, product
from pathlib import Path

import numpy as np

import telenano

KEPT = Path(__file__).with_suffix(".json")
LAWS = ("wave", "passivity", "virtual_impedance", "model_mediated", "position_force", "smith")
LINES = ("clean", "wifi", "leo_satellite", "lossy_bursts", "starlink_driving_no_memory", "verizon_driving_no_memory")
STIFFNESS_N_PER_M = (20.0, 80.0)
INSTRUMENTS = ("ideal", "real")
SEEDS = (0,)
HELD_S = (1.0, 6.0)
_HAND = {
    "kind": "force_profile",
    "points": [{"time_s": time_s, "force_n": force_n} for time_s, force_n in ((0.6, 0.0), (1.0, 1.0), (6.0, 1.0))],
}


def names() -> list[str]:
    """Return the names of the sessions: law, line, stiffness, instrument and seed."""
    return [
        f"{law} {line} {stiffness:g} {instrument} {seed}"
        for law, line, stiffness, instrument, seed in product(LAWS, LINES, STIFFNESS_N_PER_M, INSTRUMENTS, SEEDS)
    ]


def session_of(name: str) -> telenano.SimulatedSession:
    """Run the session of a name."""
    law, line, stiffness, instrument, seed = name.split()
    settings = {
        "realtime.rate_hz": 250,
        "delay_node.profile": line,
        "delay_node.seed": int(seed),
        "afm_node.rest_distance_m": 1e-9,
        "afm_node.spring.stiffness_n_per_m": float(stiffness),
        "afm_node.disturbances.seed": int(seed),
    }
    with warnings.catch_warnings():
        # some laws are told to be driven beyond what they promise
        warnings.simplefilter("ignore", UserWarning)
        return telenano.simulate(
            law=law,
            environment="spring",
            instrument=instrument,
            operator=_HAND,
            duration_s=HELD_S[1],
            settings=settings,
        )


def sizes_of(session: telenano.SimulatedSession) -> list[float]:
    """Return how far the force goes in each of the last four eighths of the hold [N], from peak to peak."""
    time_s, force_n = session["time_s"], session["scaled_tip_force_n"]
    edges = np.searchsorted(time_s, np.linspace(*HELD_S, 9)[4:])
    return [round(float(np.ptp(force_n[first:last])), 4) for first, last in pairwise(edges)]


def judged(name: str) -> dict[str, object]:
    """Return verdict and sizes of a session."""
    session = session_of(name)
    return {"verdict": session.verdict, "sizes_n": sizes_of(session)}


def kept() -> dict[str, dict[str, object]]:
    """Return what is kept."""
    found: dict[str, dict[str, object]] = json.loads(KEPT.read_text("utf-8"))
    return found


def table(found: dict[str, dict[str, object]]) -> str:
    """Return verdicts by law, instrument, and whether each of the last four eighths moves by a tenth of a newton."""
    counts: Counter[tuple[str, str, bool, str]] = Counter()
    for name, one in found.items():
        law, _, _, instrument, _ = name.split()
        counts[law, instrument, min(one["sizes_n"]) > 0.1, str(one["verdict"])] += 1  # type: ignore[call-overload]
    rows = [
        f"{law:20}{own:6}{'moves' if moves else 'rests':7}{kind:12}{n:4}"
        for (law, own, moves, kind), n in sorted(counts.items())
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    told = {name: judged(name) for name in names()}
    lines = [f" {json.dumps(name)}: {json.dumps(one)}" for name, one in told.items()]
    KEPT.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    sys.stdout.write(table(told) + "\n")

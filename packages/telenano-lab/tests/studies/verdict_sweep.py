"""Verdicts over outages: each law with each gain, on the spring, with an outage at many places of a hold.

    python packages/telenano-lab/tests/studies/verdict_sweep.py [--every 0.01]
    python packages/telenano-lab/tests/studies/verdict_sweep.py --bus 20 --out FOLDER

The theory says of each loop whether it is stable (`telenano_lab.studies.loops.theory`): no outage may make a stable
loop one that cycles or grows, and none may make an unstable one stable. A row a loop: how often which verdict. With
--bus so many drawn cells run on real processes as well, each in a session of its own, with the verdict in lockstep
beside it.
"""

import argparse
import random
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from telenano_lab.studies.loops.theory import critical_link_delay_s, loop_model
from telenano_lab.studies.loops.validate import longest_stall_s

import telenano
from telenano.cli import run_session
from telenano.sections import ControllerConfig
from telenano.settings import find_scenario, merge, nested, read_yaml
from telenano.wire import RigError

STIFFNESS_N_PER_M = 20.0
HOLD_S = (0.9, 2.4)
OUTAGES_S = (0.03, 0.12, 0.2)
# a round trip [ms]: half of what the paper's gain bears on the spring, and one and a half times as much
ROUND_TRIPS_MS = (20.0, 65.0)
GAINS = (5.0, 12.0, 20.0)
LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "model_mediated")
# the simulation is at rest for so long, and for so many round trips, before the session begins
SETTLE_S, SETTLE_ROUND_TRIPS = 0.3, 4.0
# a session on the bus that the machine held up is run again, so often at the most
TRIES = 3
# seconds that a rig may take to start and to end
OVERHEAD_S = 120.0


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


def _session(loop: Loop, outage_s: float, at_s: float, origin: str) -> dict[str, Any]:
    """Return what a session has beside its scenario: an outage of both ways at a time [s] after an origin."""
    settings: dict[str, Any] = {}
    for way in ("forward", "backward"):
        settings[f"delay_node.{way}.outage.schedule"] = [[at_s, outage_s]]
        settings[f"delay_node.{way}.outage.origin"] = origin
    if loop.gain is not None:
        settings[f"controller.{loop.law}.force_gain"] = loop.gain
    settings["afm_node.spring.stiffness_n_per_m"] = STIFFNESS_N_PER_M
    points = [(0.5, 0.0), (HOLD_S[0], 1.0), (HOLD_S[1], 1.0), (HOLD_S[1] + 0.1, 0.0)]
    operator = {"kind": "force_profile", "points": [{"time_s": t, "force_n": f} for t, f in points]}
    return {"settings": settings, "operator": operator, "duration_s": HOLD_S[1] + 0.2}


def hold_after(loop: Loop, outage_s: float, at_s: float) -> Any:
    """Return the hold of a session in lockstep with one outage of both ways, at a time of the session [s]."""
    start_s = at_s + SETTLE_S + SETTLE_ROUND_TRIPS * 1e-3 * loop.round_trip_ms
    given = _session(loop, outage_s, start_s, "settings")
    session = telenano.simulate(law=loop.law, round_trip_ms=loop.round_trip_ms, environment="spring", **given)
    return session.holds[0]


def hold_on_bus(loop: Loop, outage_s: float, at_s: float, folder: Path) -> tuple[dict[str, Any], float]:
    """Return the hold of a session on real processes as its summary has it, and how long a process stood still [s].

    A session in which the machine held a process up is run again, up to TRIES times.
    """
    given = _session(loop, outage_s, at_s, "session")
    one_way = {"delay_s": 0.5e-3 * loop.round_trip_ms}
    document = merge(
        read_yaml(find_scenario("fig12")),
        nested(given["settings"], "settings"),
        {
            "name": "outage",
            "duration_s": given["duration_s"],
            "controller": {"law": loop.law},
            "delay_node": {"forward": one_way, "backward": dict(one_way)},
            "afm_node": {"environment": "spring"},
        },
    )
    document["haptic_node"] = {"operator": given["operator"]}
    folder.mkdir(parents=True, exist_ok=True)
    scenario = folder / "cell.yaml"
    scenario.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    command = [sys.executable, "-m", "telenano", "up", "--scenario", str(scenario), "--out", str(folder)]
    command += ["--overwrite", "--headless", "--json"]
    found: dict[str, Any] | None = None
    stalled_s, failure = 0.0, "it has recorded no hold"
    for _ in range(TRIES):
        try:
            summary = run_session(command, document["duration_s"] + OVERHEAD_S)
        except RigError as error:
            failure = str(error)
            continue
        holds, stalled_s = summary["holds"], longest_stall_s(folder / "session.mcap")
        if stalled_s == 0.0:
            (found,) = holds
            break
        # Where the machine held a process up, the hold may be in parts, or there may be none.
        found = holds[0] if holds else found
    if found is None:
        raise RuntimeError(f"{folder}: the rig did not run: {failure}")
    return found, stalled_s


def drawn_cells(count: int, seed: int = 1) -> list[tuple[Loop, float, float]]:
    """Draw cells: loop, length of the outage [s] and its place in the session [s]; each loop comes before any twice."""
    draw = random.Random(seed)
    pool: list[Loop] = []
    while len(pool) < count:
        pool += draw.sample(loops(), len(loops()))
    return [(loop, draw.choice(OUTAGES_S), round(draw.uniform(*HOLD_S), 2)) for loop in pool[:count]]


class Live(NamedTuple):
    """A cell on the bus: the verdicts in lockstep and on the bus, and how long a process stood still there [s]."""

    loop: Loop
    outage_s: float
    at_s: float
    lockstep: str
    bus: str
    reason: str
    stalled_s: float

    @property
    def is_wrong(self) -> bool:
        """Return whether a verdict contradicts the theory; the machine may hold a process up and be the cause."""
        return wrong(self.loop, self.lockstep) or (self.stalled_s == 0.0 and wrong(self.loop, self.bus))

    def __str__(self) -> str:
        stalled = f"; a process stood still for {1e3 * self.stalled_s:.0f} ms" if self.stalled_s else ""
        where = f"{_words(self.loop, self.outage_s)} at {self.at_s:g} s"
        return f"{where}: lockstep {self.lockstep}, bus {self.bus} ({self.reason}){stalled}"


def live(cells: Sequence[tuple[Loop, float, float]], out: Path) -> Iterator[Live]:
    """Run cells in lockstep and on the bus, one after the other; the sessions are kept in folders of `out`."""
    for number, (loop, outage_s, at_s) in enumerate(cells, start=1):
        hold, stalled_s = hold_on_bus(loop, outage_s, at_s, out / f"{number:02d}")
        lockstep = hold_after(loop, outage_s, at_s).verdict
        yield Live(loop, outage_s, at_s, lockstep, hold["verdict"], hold["reason"], stalled_s)


def wrong(loop: Loop, kind: str) -> bool:
    """Return whether a verdict contradicts the theory."""
    return kind in (("diverged", "limit_cycle") if loop.is_stable else ("stable",))


def _words(loop: Loop, outage_s: float) -> str:
    gain = "" if loop.gain is None else f", K_f {loop.gain:g}"
    says = "stable" if loop.is_stable else "unstable"
    return f"{loop.law}{gain}, {loop.round_trip_ms:g} ms ({says}), outage {1e3 * outage_s:g} ms"


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
    parser.add_argument("--bus", type=int, default=0, metavar="N", help="run N drawn cells on real processes instead")
    parser.add_argument("--out", type=Path, default=Path("out/outages"), help="folder of the sessions of --bus")
    given = parser.parse_args()
    if given.bus:
        errors = 0
        for cell in live(drawn_cells(given.bus), given.out):
            errors += cell.is_wrong
            sys.stdout.write(f"{cell}\n")
            sys.stdout.flush()
        sys.stdout.write(f"{errors} of {given.bus} cells contradict the theory\n")
        return int(errors > 0)
    found = sweep(given.every)
    for (loop, outage_s), kinds in found.items():
        sys.stdout.write(f"{_words(loop, outage_s)}: {dict(kinds)}\n")
    errors = sum(count for (loop, _), kinds in found.items() for kind, count in kinds.items() if wrong(loop, kind))
    sys.stdout.write(f"{errors} of {sum(map(Counter.total, found.values()))} verdicts contradict the theory\n")
    return int(errors > 0)


if __name__ == "__main__":
    sys.exit(main())

"""Verdicts under noise: each law with each gain, on the spring, with a named instrument and a hand that may tremble.

    python packages/telenano-lab/tests/studies/noise_sweep.py [--seeds 4] [--instrument real,real_drifting]

The theory says of each loop whether it is stable (`telenano_lab.studies.loops.theory`): no noise, drift or trembling
may make a stable loop one that cycles or grows, and none may make an unstable one stable. The hysteresis of the piezo
makes small motions softer, and the stage is late: only loops that are stable, or unstable, with both are judged.
"""

import argparse
import sys
from collections import Counter
from typing import Any, NamedTuple

from telenano_lab.studies.loops.theory import critical_link_delay_s, loop_model
from verdict_sweep import GAINS, LAWS, STIFFNESS_N_PER_M, Loop, wrong

import telenano
from telenano.afm import piezo_params
from telenano.sections import ControllerConfig
from telenano.settings import DisturbanceConfig, instrument_named

HOLD_S = (0.9, 6.9)
# round trips [ms]: half of what the paper's gain bears on the spring, and twice as much
ROUND_TRIPS_MS = (0.0, 20.0, 90.0)
TREMBLING = {
    "haptic_node.disturbances.tremor.enabled": True,
    "haptic_node.disturbances.tremor.rms_n": 0.02,
    "haptic_node.disturbances.wander.enabled": True,
}
# The stage of the named instruments is late by this time [s], 2 d / w of 200 Hz.
STAGE_S = 1.2e-3


class Case(NamedTuple):
    """A loop with an instrument, and whether its hand trembles."""

    loop: Loop
    instrument: str
    trembles: bool

    def __str__(self) -> str:
        gain = "" if self.loop.gain is None else f", K_f {self.loop.gain:g}"
        says = "stable" if self.loop.is_stable else "unstable"
        hand = "trembling" if self.trembles else "scripted"
        return f"{self.loop.law}{gain}, {self.loop.round_trip_ms:g} ms ({says}), {self.instrument}, {hand} hand"


def softest_share(instrument: str) -> float:
    """Return which share of a small motion the piezo of an instrument makes: its plays stand still."""
    section = instrument_named(instrument).scenario["afm_node"]["disturbances"]
    config = DisturbanceConfig.model_validate(section)
    piezo = piezo_params(config.hysteresis, config.creep)
    return 1.0 - piezo.play_weight * len(piezo.play_radii_m) - piezo.lag_share * len(piezo.lags_s)


def cases(instruments: tuple[str, ...]) -> list[Case]:
    """Return the cases of which theory knows the truth; laws without a linear loop are passive and always stable."""
    found = []
    for instrument in instruments:
        for law in LAWS:
            for gain in GAINS if law == "virtual_impedance" else (None,):
                least, most = (_edge_ms(law, gain, share) for share in (1.0, softest_share(instrument)))
                for trip_ms in ROUND_TRIPS_MS:
                    is_stable = trip_ms < least - 1e3 * STAGE_S
                    if is_stable or trip_ms > most:
                        loop = Loop(law, gain, trip_ms, is_stable)
                        found += [Case(loop, instrument, trembles) for trembles in (False, True)]
    return found


def _edge_ms(law: str, gain: float | None, share: float) -> float:
    section: dict[str, Any] = {"law": law, law: {} if gain is None else {"force_gain": gain}}
    controller = ControllerConfig.model_validate(section)
    model = loop_model(law, controller.law_config(), share * STIFFNESS_N_PER_M)
    return float("inf") if model is None else 1e3 * critical_link_delay_s(model, controller.period_s)


def hold_of(case: Case, seed: int) -> Any:
    """Return the hold of a session in lockstep with the noise of a seed."""
    points = [(0.5, 0.0), (HOLD_S[0], 1.0), (HOLD_S[1], 1.0), (HOLD_S[1] + 0.1, 0.0)]
    settings = {"afm_node.disturbances.seed": seed, "afm_node.spring.stiffness_n_per_m": STIFFNESS_N_PER_M}
    settings |= {**TREMBLING, "haptic_node.disturbances.seed": seed} if case.trembles else {}
    if case.loop.gain is not None:
        settings[f"controller.{case.loop.law}.force_gain"] = case.loop.gain
    session = telenano.simulate(
        law=case.loop.law,
        round_trip_ms=case.loop.round_trip_ms,
        environment="spring",
        instrument=case.instrument,
        operator={"kind": "force_profile", "points": [{"time_s": t, "force_n": f} for t, f in points]},
        duration_s=HOLD_S[1] + 0.2,
        settings=settings,
    )
    middle_s = 0.5 * sum(HOLD_S)
    return next((hold for hold in session.holds if hold.start_s < middle_s < hold.end_s), None)


class Told(NamedTuple):
    """What the judge says of a hold with the noise of a seed."""

    seed: int
    kind: str
    reason: str
    facts: tuple[str, ...]


def judged(case: Case, seed: int) -> Told:
    """Return what the judge says of a case with the noise of a seed."""
    hold = hold_of(case, seed)
    if hold is None:
        return Told(seed, "no hold", "", ())
    return Told(seed, hold.verdict, hold.reason, tuple(fact.kind for fact in hold.facts))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instrument", default="real,real_drifting", help="names, with commas between them")
    parser.add_argument("--seeds", type=int, default=4, help="how many seeds of the noise")
    given = parser.parse_args()
    errors = total = 0
    for case in cases(tuple(given.instrument.split(","))):
        found = [judged(case, seed) for seed in range(given.seeds)]
        kinds, facts = Counter(one.kind for one in found), Counter(fact for one in found for fact in one.facts)
        sys.stdout.write(f"{case}: {dict(kinds)}, facts {dict(facts)}\n")
        for one in found:
            total += 1
            errors += wrong(case.loop, one.kind)
            if wrong(case.loop, one.kind) or one.kind in ("cannot_say", "no hold"):
                sys.stdout.write(f"    seed {one.seed}: {one.kind}: {one.reason}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{errors} of {total} verdicts contradict the theory\n")
    return int(errors > 0)


if __name__ == "__main__":
    sys.exit(main())

"""How often a session is warned of wrongly that its hand feels far from what is there, or is not warned of."""

from collections import Counter

import pytest
from made_sessions_felt import MadeSession, made_session

HARD, SOFT = 1.5, 0.6


def truth_of(made: MadeSession) -> str:
    """Return what the hand truly feels, clear where it is a tenth beyond a limit; none of one that is not stable."""
    if made.session.verdict != "stable":
        return "none"
    if made.kind != "swings":
        # Of a hand that only presses the way that it went tells what it felt, and not to a tenth.
        return "near" if 0.75 < made.ratio < 1.3 else "far"
    if made.ratio > HARD or made.ratio < SOFT:
        clear = made.ratio > 1.1 * HARD or made.ratio < 0.9 * SOFT
        return "far, clear" if clear else "far"
    return "near"


def said_of(made: MadeSession) -> str:
    found = made.session.felt_stiffness
    if found.outside:
        return "warned"
    return "not known" if found.felt is None else "silent"


def shares(seeds: range) -> Counter[str]:
    found: Counter[str] = Counter()
    for seed in seeds:
        made = made_session(seed)
        truth, said = truth_of(made), said_of(made)
        found[truth] += 1
        found[f"{truth}: {said}"] += 1
        if truth != "none" and made.kind == "swings":
            found["swings"] += 1
            found[f"swings: {said}"] += 1
        felt = made.session.felt_stiffness.felt
        if truth != "none" and made.kind == "swings" and felt is not None:
            found["stated"] += 1
            found["covered"] += 0.95 * felt.low <= made.ratio <= 1.05 * felt.high
            # A sample that is felt too soft is not said to be felt too hard.
            kinds = {one.felt.kind for one in made.session.felt_stiffness.outside}
            found["wrong way"] += ("hard" in kinds and made.ratio < 1.0) or ("soft" in kinds and made.ratio > 1.0)
    return found


def check(found: Counter[str], near: float, clear: float) -> None:
    assert found["near: warned"] <= near * found["near"], found
    assert found["far, clear: silent"] <= clear * found["far, clear"], found
    assert found["wrong way"] == 0, found
    # Of a hand that swings in a stable session little cannot be known.
    assert found["swings: not known"] <= 0.1 * found["swings"], found
    assert found["covered"] >= 0.9 * found["stated"], found


@pytest.mark.check("simulates 9 sessions of 14 s")
def test_made_sessions_are_rarely_warned_of_wrongly_and_rarely_missed() -> None:
    found = shares(range(9))
    assert found["near"] >= 3 and found["far, clear"] >= 1, found
    check(found, 0.0, 0.0)


@pytest.mark.endurance("simulates 400 sessions of 14 s, some 5 min")
def test_many_made_sessions_are_rarely_warned_of_wrongly_and_rarely_missed() -> None:
    found = shares(range(1000, 1400))
    assert found["near"] > 60 and found["far, clear"] > 30, found
    check(found, 0.02, 0.03)

"""The variants of a measured line differ in what they say they differ in, and share the rest."""

import math
from pathlib import Path

import numpy as np
import pytest
from telenano_studies.loops.line_variants import between, variants

from services.delay_node.config import parse_settings
from services.delay_node.engine import fates_of
from telenano.extend.sessions import profile_named

PERIOD_S, TIME_S = 0.2, 0.4


def test_between_two_messages_of_the_log_the_rules_differ_and_at_them_they_do_not() -> None:
    found = between(TIME_S, PERIOD_S, 3, 400.0)
    at = np.arange(0, 400_001, 200)
    for name in ("linear", "kept"):
        np.testing.assert_array_equal(found[name][at], found["exponential"][at])
        assert np.abs(found[name] - found["exponential"]).max() > 0.5
    for name, scores in found.items():
        rho = float(np.corrcoef(scores[at[:-1]], scores[at[1:]])[0, 1])
        # 2000 pairs
        assert rho == pytest.approx(math.exp(-PERIOD_S / TIME_S), abs=0.08), name
    steps = {name: float(np.diff(scores).std()) for name, scores in found.items()}
    assert steps["linear"] < steps["exponential"] < steps["a part flickers"]


def test_the_variants_share_a_round_trip_as_they_say(tmp_path: Path) -> None:
    way = profile_named("att_driving").link["forward"]
    found = {(one.group, one.name): one for one in variants(way, PERIOD_S, 1, 30.0, tmp_path)}
    assert len(found) == 14

    def delays_ms(one: tuple[str, str], direction: str) -> np.ndarray:  # type: ignore[type-arg]
        ways = {"forward": found[one].forward, "backward": found[one].backward}
        settings = parse_settings({"seed": 1, **ways})
        fates = fates_of(settings, direction, "udp", range(0, 30 * 10**9, 10**7), 200, folder=tmp_path)  # type: ignore[arg-type]
        return np.array([1e-6 * fate.delay_ns for fate in fates if not fate.dropped])

    least_ms = 11.7
    assert set(delays_ms(("sharing", "all of it forward"), "backward").tolist()) == {least_ms}
    half = delays_ms(("sharing", "half of it each way"), "forward")
    whole = delays_ms(("sharing", "all of it forward"), "forward")
    assert float(np.median(whole)) - least_ms == pytest.approx(2.0 * (float(np.median(half)) - least_ms), rel=0.1)
    assert set(delays_ms(("parts", "constant delay"), "forward").tolist()) == {41.65}
    drawn = delays_ms(("parts", "usual delays, each by itself"), "forward")
    kept = delays_ms(("parts", "usual delays with memory"), "forward")
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 0.1 < np.corrcoef(kept[:-1], kept[1:])[0, 1]
    held = found["parts", "constant delay, stalls that hold"].forward["outage"]
    lost = found["parts", "constant delay, stalls that lose"].forward["outage"]
    assert (held["mode"], lost["mode"]) == ("hold", "drop")
    assert {**held, "mode": "drop"} == lost

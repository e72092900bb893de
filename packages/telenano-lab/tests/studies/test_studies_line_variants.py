"""The variants of a measured line differ in what they say they differ in, and share the rest."""

import math
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.studies.loops import line_variants
from telenano_lab.studies.loops.line_variants import between, half_of, stalls_of_both, variants

from telenano.link import DirectionEngine
from telenano.settings import LinkSettings, profile_named

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
    way = half_of(profile_named("att_driving").link)
    found = {(one.group, one.name): one for one in variants(way, PERIOD_S, 1, 30.0, tmp_path)}
    assert len(found) == 14

    def delays_ms(one: tuple[str, str], direction: str) -> np.ndarray:  # type: ignore[type-arg]
        ways = {"forward": found[one].forward, "backward": found[one].backward}
        settings = LinkSettings.of({"seed": 1, **ways})
        fates = DirectionEngine.fates(settings, direction, "udp", range(0, 30 * 10**9, 10**7), 200, folder=tmp_path)  # type: ignore[arg-type]
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


def test_the_stalls_of_both_ways_come_as_often_and_last_as_long_as_those_of_the_line() -> None:
    outage = half_of(profile_named("cicv5g_n78_arterial").link)["outage"]
    schedule = stalls_of_both(outage, 1, 3500.0)
    begins_s, lengths_s = np.array(schedule).T
    assert (np.diff(begins_s) > lengths_s[:-1]).all()
    # some 180 stalls
    assert np.diff(begins_s).mean() == pytest.approx(0.5 * outage["mean_up_s"] + outage["mean_down_s"], rel=0.25)
    assert lengths_s.mean() == pytest.approx(outage["mean_down_s"], rel=0.05)
    LinkSettings.of({"forward": {"outage": {"schedule": schedule, "mode": "hold"}}})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["starlink_driving", "--seeds", "0"], "'0' is not a number of seeds; give 1 or more"),
        (["mars"], "unknown profile 'mars'"),
        (["clean"], "the network clean has no quantiles and correlation time, as `telenano link fit` makes them"),
    ],
)
def test_what_cannot_be_run_is_said_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], given: list[str], said: str
) -> None:
    monkeypatch.setattr("sys.argv", ["line_variants", *given, "--out", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        line_variants.main()
    assert ended.value.code == 2
    assert said in capsys.readouterr().err

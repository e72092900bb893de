"""The analysis finds the effect that a made-up experiment has, with the right size and interval."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from observer import Observer
from telenano_lab.doubles.made_journals import DELAYS_MS, LAWS, SLOPE, demo, trial
from telenano_lab.experiments.analyse import Choice, analyse
from telenano_lab.experiments.effect_sizes import corrected, partial_eta2
from telenano_lab.experiments.effects import Effects
from telenano_lab.experiments.psychophysics.function import Psychometric
from telenano_lab.experiments.table import tidy

from telenano.analysis import FigureOptions
from telenano.wire import ConfigError

pytest.importorskip("pandas")
pytest.importorskip("statsmodels")
TIME = Choice(measures=("completion_time_s",))
CATEGORIES = TIME._replace(categories=("delay_ms",))


def of_time(records: list[dict[str, Any]], choice: Choice = TIME) -> Effects:
    return analyse(tidy(records), choice).effects["touch_and_hold", "completion_time_s"]


def test_time_is_found_to_grow_with_delay() -> None:
    found = of_time(demo(2))
    assert found.model.startswith("repeated-measures F") and not found.remarks
    (slope,) = found.slopes
    assert slope.factor == "delay_ms" and slope.low < SLOPE < slope.high
    assert abs(slope.slope / SLOPE - 1.0) < 0.25 and slope.p < 0.01
    terms = {term.term: term for term in found.terms}
    assert list(terms) == ["law", "delay_ms", "law × delay_ms"]
    assert terms["delay_ms"].p_corrected is not None and terms["delay_ms"].p_corrected < 0.01
    assert terms["law × delay_ms"].p > 0.05
    # of a balanced experiment the two levels of a factor are tested as by Student's t of participants' differences
    law = next(pair for pair in found.pairs if pair.factor == "law")
    assert terms["law"].p == pytest.approx(law.p, rel=1e-9)


def coverage(seeds: range, participants: int = 4) -> float:
    slopes = [of_time(demo(seed, participants)).slopes for seed in seeds]
    return sum(slope.low <= SLOPE <= slope.high for (slope,) in slopes) / len(seeds)


@pytest.mark.endurance
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("participants", [4, 12])
def test_95_percent_intervals_of_the_slope_have_it_in_93_percent_or_more(participants: int) -> None:
    assert coverage(range(300), participants) >= 0.93


def test_the_effects_of_categories_are_those_of_statsmodels() -> None:
    import pandas as pd
    from statsmodels.stats.anova import AnovaRM

    rows = pd.DataFrame(tidy(demo(1)).trials).rename(columns={"condition.law": "law", "condition.delay_ms": "delay_ms"})
    made = AnovaRM(rows, "completion_time_s", "participant", ["law", "delay_ms"], aggregate_func="mean").fit()
    found = of_time(demo(1), CATEGORIES)
    assert not found.slopes and len(found.terms) == 3
    for term in found.terms:
        row = made.anova_table.loc[term.term.replace(" × ", ":")]
        assert (term.f, term.df1, term.df2) == pytest.approx(tuple(row[["F Value", "Num DF", "Den DF"]]), rel=1e-9)
        assert 0.5 <= term.epsilon <= 1.0 and term.p >= row["Pr > F"] * (1.0 - 1e-9)
    terms = {term.term: term for term in found.terms}
    assert terms["delay_ms"].p < 0.001 and terms["law × delay_ms"].p > 0.05
    # two levels have no sphericity to violate
    assert terms["law"].epsilon == 1.0


def test_a_slope_is_that_of_the_participants_own() -> None:
    from scipy import stats

    own: dict[str, list[tuple[float, float]]] = {}
    for record in demo(3, 5):
        own.setdefault(record["participant"], []).append(
            (record["condition"]["delay_ms"], record["measures"]["completion_time_s"])
        )
    slopes = [float(np.polyfit(*np.transpose(points), 1)[0]) for points in own.values()]
    test = stats.ttest_1samp(slopes, 0.0)
    (slope,) = of_time(demo(3, 5)).slopes
    interval = test.confidence_interval(0.95)
    assert (slope.slope, slope.low, slope.high, slope.p) == pytest.approx(
        (np.mean(slopes), interval.low, interval.high, test.pvalue), rel=1e-9
    )


def test_a_factor_between_participants_is_tested_against_their_scatter_within_groups() -> None:
    from scipy import stats

    records = demo(3, 7)
    hands = {f"P{number:02d}": "left" if number < 4 else "right" for number in range(1, 8)}
    for record in records:
        record["condition"] = {"law": record["condition"]["law"], "hand": hands[record["participant"]]}
    found = {term.term: term for term in of_time(records).terms}
    means: dict[tuple[str, str], list[float]] = {}
    for record in records:
        key = record["participant"], record["condition"]["law"]
        means.setdefault(key, []).append(record["measures"]["completion_time_s"])
    cells = {key: float(np.mean(values)) for key, values in means.items()}
    for term, sign in (("hand", 1.0), ("hand × law", -1.0)):
        sides = [
            [cells[person, LAWS[0]] + sign * cells[person, LAWS[1]] for person, hand in hands.items() if hand == side]
            for side in ("left", "right")
        ]
        assert found[term if term in found else "law × hand"].p == pytest.approx(
            stats.ttest_ind(*sides).pvalue, rel=1e-9
        )


def test_partial_eta2_has_the_interval_of_the_noncentral_f_distribution() -> None:
    from scipy import stats

    eta, low, high = partial_eta2(6.0, 2.0, 30.0)
    assert eta == pytest.approx(12.0 / 42.0)
    for share, chance in ((low, 0.975), (high, 0.025)):
        centre = share * 33.0 / (1.0 - share)
        assert stats.ncf.cdf(6.0, 2.0, 30.0, centre) == pytest.approx(chance, abs=1e-6)
    assert partial_eta2(0.5, 2.0, 30.0)[1] == 0.0


def test_p_values_are_corrected_by_the_method_that_is_asked_for() -> None:
    ps = [0.01, 0.02, 0.5]
    assert corrected(ps, "holm") == pytest.approx([0.03, 0.04, 0.5])
    assert corrected(ps, "bonferroni") == pytest.approx([0.03, 0.06, 1.0])
    assert corrected(ps, "none") == ps and corrected([], "holm") == []
    from statsmodels.stats.multitest import multipletests

    drawn = np.random.default_rng(3).uniform(size=9) ** 2
    for name in ("holm", "bonferroni", "fdr_bh"):
        assert corrected(drawn.tolist(), name) == pytest.approx(multipletests(drawn, method=name)[1], rel=1e-12)
    found = of_time(demo(1), TIME._replace(correction="bonferroni"))
    assert all(pair.p_corrected == pytest.approx(min(1.0, 4.0 * pair.p)) for pair in found.pairs)


def test_levels_can_be_compared_at_each_level_of_another_factor() -> None:
    found = of_time(demo(1), TIME._replace(within="law"))
    assert [(pair.at, pair.factor) for pair in found.pairs] == [
        (f"law = {law}", "delay_ms") for law in LAWS for _ in range(3)
    ]
    at_wave = [record for record in demo(1) if record["condition"]["law"] == "wave"]
    alone = of_time(at_wave, TIME)
    assert [pair.difference for pair in found.pairs[3:]] == [pair.difference for pair in alone.pairs]
    with pytest.raises(ConfigError, match=r"factor laws: did you mean law\? Known are law, delay_ms"):
        of_time(demo(1), TIME._replace(within="laws"))


def test_a_factor_between_participants_is_tested_between_them() -> None:
    records = demo(3, participants=6)
    for record in records:
        group = "trained" if int(record["participant"][1:]) % 2 else "new"
        record["condition"] = {"delay_ms": record["condition"]["delay_ms"], "group": group}
    found = of_time(records)
    group = next(term for term in found.terms if term.term == "group")
    assert group.df2 == 4.0
    (pair,) = [pair for pair in found.pairs if pair.factor == "group"]
    assert (pair.level, pair.against) == ("trained", "new") and pair.df <= 4.0 + 1e-9


def test_trials_that_do_not_count_change_nothing() -> None:
    records = demo(1)
    plain = analyse(tidy(records), TIME)
    other = [dict(record) for record in records[:6]]
    for place, changes in enumerate(({"phase": "practice"}, {"status": "disturbed"}, {"status": "aborted"})):
        other[place] |= {**changes, "measures": {"completion_time_s": 99.0}, "attempt": 1}
    out = [{**record, "participant": "P09", "measures": {"completion_time_s": 99.0}} for record in records[:18]]
    more = analyse(
        tidy([*records, *other[:3], *out, {"record": "excluded", "participant": "P09", "reason": "left"}]), TIME
    )
    assert more.effects == plain.effects and more.cells == plain.cells
    assert more.counts == {
        "participants": 4, "excluded": 1, "trials": 72, "disturbed": 1, "aborted": 1, "practice": 1,
    }  # fmt: skip


def test_the_cells_describe_every_condition() -> None:
    found = analyse(tidy(demo(1)), Choice())
    cells = [cell for cell in found.cells if cell["measure"] == "completion_time_s"]
    assert [(cell["law"], cell["delay_ms"]) for cell in cells] == [(law, delay) for law in LAWS for delay in DELAYS_MS]
    assert all(cell["participants"] == 4 and cell["trials"] == 12 for cell in cells)
    assert all(cell["least"] <= cell["quarter"] <= cell["median"] <= cell["greatest"] for cell in cells)
    assert all(cell["low"] < cell["mean"] < cell["high"] for cell in cells)
    shares = [cell for cell in found.cells if cell["measure"] == "success"]
    assert all(0.0 <= cell["low"] <= cell["high"] <= 1.0 for cell in shares)


def test_one_participant_is_described_and_not_tested() -> None:
    found = of_time(demo(1, participants=1))
    assert not found.terms and found.remarks == ("one participant has values: nothing is tested",)


def test_a_difference_without_any_scatter_is_said_and_not_tested() -> None:
    records = [
        trial(f"P{n}", k, {"law": law}, completion_time_s=2.0 * k)
        for n in range(3)
        for k, law in enumerate(("wave", "passivity"))
    ]
    found = of_time(records, TIME)
    assert not found.terms and not found.pairs
    assert found.remarks == ("every participant has the same difference: law is not tested",)


def test_a_measure_that_never_changes_is_not_tested() -> None:
    records = [trial(f"P{n}", n, {"delay_ms": float(10 * (n % 2))}, completion_time_s=2.0) for n in range(8)]
    assert of_time(records).remarks == ("every trial has the same value: nothing is tested",)


def test_thresholds_are_fitted_for_each_participant_and_condition() -> None:
    model = Psychometric()
    settings = {"method": "constant", "levels": [0.02, 0.04, 0.06, 0.08, 0.1, 0.12], "repetitions": 30}
    records, truth = [], {"P01": 0.05, "P02": 0.08}
    for participant, threshold in truth.items():
        for law in LAWS:
            observer = Observer(model, threshold, 0.06, 0.0, 7)
            for index in range(180):
                level = settings["levels"][index % 6]  # type: ignore[index]
                condition = {"law": law, "delay_s": level}
                records.append(trial(participant, index, condition, correct=observer.answer(level)))
    found = analyse(tidy(records), adaptive={"delay_s": settings})
    assert [(row["participant"], row["law"]) for row in found.thresholds] == [(p, law) for p in truth for law in LAWS]
    assert all(row["low"] < truth[row["participant"]] < row["high"] for row in found.thresholds)
    assert [factor.name for factor in found.factors["touch_and_hold"]] == ["law"]
    # two participants are described, and not tested
    tested = found.effects["touch_and_hold", "threshold of delay_s"]
    assert not tested.terms and "a test needs 3" in tested.remarks[0]


def test_a_preference_for_the_first_interval_is_told_from_sensitivity() -> None:
    # right in 30 of 40 alike, once without and once with a preference for the first
    right = {"P01": (15, 15), "P02": (19, 11)}
    records = [
        trial(person, 20 * first + n, {"law": "wave"}, comparison_first=not first, chose_first=(n < hits) is not first)
        for person, counts in right.items()
        for first, hits in zip((False, True), counts, strict=True)
        for n in range(20)
    ]
    found = {row["participant"]: row for row in analyse(tidy(records)).detections}
    assert found["P01"]["criterion"] == pytest.approx(0.0, abs=1e-12) and found["P02"]["criterion_high"] < 0.0
    assert (
        found["P01"]["d_prime"] == pytest.approx(0.94, abs=0.06) and found["P02"]["d_prime"] > found["P01"]["d_prime"]
    )


def test_a_touch_that_is_detected_has_the_time_before_it_as_noise() -> None:
    records = [trial("P01", n, {"law": "wave"}, success=n >= 4, false_alarm=n < 2) for n in range(20)]
    (found,) = analyse(tidy(records)).detections
    assert (found["signals"], found["others"]) == (18, 20) and found["d_prime_low"] > 0.0


def test_what_cannot_be_analysed_is_said() -> None:
    with pytest.raises(ConfigError, match="no trial counts"):
        analyse(tidy([]))
    with pytest.raises(ConfigError, match=r"measure completion_tine_s: did you mean completion_time_s. Known are "):
        analyse(tidy(demo(1)), Choice(measures=("completion_tine_s",)))
    with pytest.raises(ConfigError, match=r"correction holms: did you mean holm\? Known are holm"):
        analyse(tidy(demo(1)), Choice(correction="holms"))
    with pytest.raises(ConfigError, match="thresholds need a measure or an answer named `correct`"):
        analyse(tidy(demo(1)), adaptive={"delay_ms": {}})


def test_everything_is_written_with_what_a_paper_has_to_say(tmp_path: Path) -> None:
    from telenano_lab.experiments.analysis_page import write_analysis

    tables = tidy(demo(1), lambda task: {"completion_time_s": ("s", "Completion time")})
    found = analyse(tables, TIME)
    about = {"title": "Time and delay", "seed": 3, "order": "latin square", "apparatus": "lockstep", "digest": "ab12"}
    document = write_analysis(
        tmp_path, found, tables, about, "telenano experiment analyse x", FigureOptions.of("png,svg")
    )
    names = {path.name for path in tmp_path.iterdir()}
    assert {
        "trials.parquet",
        "trials.csv",
        "dictionary.md",
        "experiment.json",
        "experiment.html",
        "methods.md",
    } <= names
    assert {"touch_and_hold_completion_time_s.png", "touch_and_hold_completion_time_s.svg", "effect_sizes.png"} <= names
    methods = (tmp_path / "methods.md").read_text()
    for words in (
        "4 participants completed 72 trials",
        "0, 40, 80 ms",
        "latin square, from seed 3",
        "statsmodels",
        "ab12",
    ):
        assert words in methods, words
    assert json.loads((tmp_path / "experiment.json").read_text()) == json.loads(json.dumps(document))
    terms = {row["term"]: row["f"] for row in document["terms"]}
    assert terms == {term.term: term.f for term in found.effects["touch_and_hold", "completion_time_s"].terms}

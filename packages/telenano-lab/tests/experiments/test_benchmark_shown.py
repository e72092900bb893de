"""The table of what laws were shown to hold is that of all runs, and a guarded one was not held."""

import json
from pathlib import Path

import pytest
from telenano_lab.experiments.benchmark.plan import VERSION, Run
from telenano_lab.experiments.benchmark.results import digest_of, runs_text
from telenano_lab.experiments.benchmark.run import MEASURES, Outcome
from telenano_lab.experiments.benchmark.shown import line_of, main, shown_of, stiffness_of, text_of

from telenano.analysis import wilson


def outcome(verdict: str, tracking: float | None = None, **changes: object) -> Outcome:
    run = {"task": "track", "network": "clean", "law": "wave", "hand": "force", "seed": 0, **changes}
    return Outcome(Run.model_validate(run), verdict, "", {**dict.fromkeys(MEASURES), "tracking_error": tracking})


RUNS = runs_text(
    [
        *(outcome("stable", 0.1 * seed, seed=seed) for seed in range(3)),
        outcome("diverged", hand="soft"),
        outcome("guarded", hand="stiff"),
        outcome("stable", task="stiff", instrument="real"),
        outcome("guarded", law="passivity"),
    ]
)


def test_a_cell_counts_the_runs_of_every_hand_and_guarded_ones_as_not_held() -> None:
    shown = shown_of(RUNS)
    assert (shown["benchmark"], shown["digest"]) == (VERSION, digest_of(RUNS))
    low, high = (round(end, 3) for end in wilson(3, 5))
    one = [round(end, 3) for end in wilson(1, 1)]
    assert shown["laws"]["wave"] == {
        "tracking_error": 0.1,
        "cells": [["clean", 20.0, 0.0, 5, 3, low, high, 1], ["clean", 80.0, 10.0, 1, 1, *one, 0]],
    }
    none = [round(end, 3) for end in wilson(0, 1)]
    assert shown["laws"]["passivity"] == {"tracking_error": None, "cells": [["clean", 20.0, 0.0, 1, 0, *none, 1]]}


@pytest.mark.check("draws 80 s of two lines")
def test_a_line_is_what_the_newest_answer_of_a_loop_is_late_by() -> None:
    assert line_of("clean") == {"round_trip_ms": 0.0, "unevenness_ms": 0.0}
    found = line_of("transatlantic")
    assert found["round_trip_ms"] == pytest.approx(78.3, abs=0.6) and found["unevenness_ms"] <= 2.0
    # Where each message is delayed by itself, one of the last few is fast, and the loop is sooner than their mean.
    assert line_of("verizon_driving_no_memory")["round_trip_ms"] < 0.6 * 100.7


def test_a_sample_is_what_the_base_meets() -> None:
    assert (stiffness_of("touch"), stiffness_of("track"), stiffness_of("stiff")) == (38.0, 20.0, 80.0)
    # The cantilever of 40 N/m is in series with its contact, which is softer than mica.
    assert stiffness_of("hold") == pytest.approx(17.5, abs=1.0)


def test_the_command_writes_the_table_that_the_function_returns(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").write_text(RUNS, newline="")
    main([str(tmp_path / "runs.csv"), str(tmp_path / "shown.json")])
    text = (tmp_path / "shown.json").read_text()
    assert text == text_of(shown_of(RUNS))
    assert json.loads(text) == shown_of(RUNS)


@pytest.mark.parametrize(
    ("runs", "reason"),
    [
        ("a,b\n1,2\n", "the first line must name"),
        (RUNS.replace(f"\n{VERSION},", "\n1,"), "runs of benchmark 1"),
        (runs_text([outcome("stable", settings=(("wave.filter_s", 0.1),))]), "changed settings"),
    ],
)
def test_other_runs_are_refused_with_the_reason(tmp_path: Path, runs: str, reason: str) -> None:
    (tmp_path / "runs.csv").write_text(runs, newline="")
    with pytest.raises(SystemExit, match=reason):
        main([str(tmp_path / "runs.csv"), str(tmp_path / "shown.json")])
    assert not (tmp_path / "shown.json").exists()

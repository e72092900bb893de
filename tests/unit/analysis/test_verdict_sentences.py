"""Findings in words: each figure that a reader needs stands in the sentence, and none that does not apply."""

from typing import Any

import pytest

from telenano.analysis.findings import Cause, Finding
from telenano.analysis.modes import LEAST_SAMPLES
from telenano.analysis.verdict_sentences import sentence

# Every figure has digits of its own, so that a sentence shows which ones it has.
FIGURES: dict[str, Any] = {
    "size_n": 0.311,
    "growth_per_s": 0.422,
    "decisive_n": 0.533,
    "error_per_s": 0.644,
    "frequency_hz": 7.55,
    "needs_s": 86.0,
    "needs_noise_n": 0.0097,
}


def said(cause: Cause, **changes: Any) -> str:
    return sentence(Finding("cannot_say", cause, **{**FIGURES, **changes}), 0.128)


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        (Cause.HIDDEN_BY_NOISE, ("noise of 0.13 N hides", "less than 0.0097 N")),
        (Cause.LIKE_NOISE, ("0.311 N from peak to peak",)),
        (Cause.ON_ITS_WAY, ("0.533 N", "86 s or more")),
        (
            Cause.CHANGE_UNKNOWN,
            ("0.533 N from peak to peak at 7.55 Hz", "0.42 ± 0.64/s", "86 s or more", "noise of less than 0.0097 N"),
        ),
        (Cause.IRREGULAR_UNKNOWN, ("0.311 N from peak to peak", "a longer hold")),
        (Cause.WITHIN_A_STEP, ("0.311 N from peak to peak", "steps of less than 0.0097 N")),
        (Cause.GROWS, ("0.533 N from peak to peak at 7.55 Hz grows by 0.422/s",)),
        (Cause.GOES_ON, ("0.311 N from peak to peak at 7.55 Hz",)),
        (Cause.IRREGULAR, ("0.311 N from peak to peak",)),
        (Cause.AT_REST, ("0.53 N from peak to peak",)),
        (Cause.MOVED, ("0.53 N to one side",)),
        (Cause.TO_THE_REST, ("0.53 N are left",)),
    ],
)
def test_a_sentence_has_the_figures_that_decide(cause: Cause, words: tuple[str, ...]) -> None:
    text = said(cause)
    for part in words:
        assert part in text
    # And no other figure than these.
    for name, figure in (("0.311", "0.311"), ("0.42", "0.42"), ("0.53", "0.53"), ("7.55", "7.55"), ("86", "86 s")):
        assert (figure in text) is any(name in part for part in words), text


def test_a_motion_without_a_frequency_swings_or_goes_to_one_side() -> None:
    assert said(Cause.GROWS, frequency_hz=None) == "a motion of 0.533 N from peak to peak grows by 0.422/s"
    assert said(Cause.GROWS, frequency_hz=0.0) == "a motion of 0.533 N to one side grows by 0.422/s"
    assert "Hz" not in said(Cause.GOES_ON, frequency_hz=None)
    assert "by 0/s" in said(Cause.GROWS, growth_per_s=None)


def test_what_would_decide_is_named_where_it_is_known() -> None:
    assert "noise" not in said(Cause.CHANGE_UNKNOWN, needs_noise_n=0.0)
    assert said(Cause.AT_REST, decisive_n=0.0) == "at rest"


def test_a_decay_has_a_positive_rate_and_what_is_left_of_it_from_a_micronewton_on() -> None:
    assert said(Cause.DIES_OUT, growth_per_s=-0.25) == "the motion dies out by 0.25/s, 0.53 N are left"
    assert said(Cause.DIES_OUT, growth_per_s=-0.25, decisive_n=1e-6).endswith("1e-06 N are left")
    assert said(Cause.DIES_OUT, growth_per_s=-0.25, decisive_n=0.9e-6) == "the motion dies out by 0.25/s"


def test_too_few_samples_need_more_of_them_or_a_longer_hold() -> None:
    few = said(Cause.FEW_SAMPLES, samples=LEAST_SAMPLES - 1)
    assert few == f"{LEAST_SAMPLES - 1} samples were taken of it: {LEAST_SAMPLES} or more would decide"
    enough = said(Cause.FEW_SAMPLES, samples=LEAST_SAMPLES)
    assert enough == f"{LEAST_SAMPLES} samples were taken of a motion of 0.31 N: a longer hold would decide"


def test_a_force_that_is_no_number_is_said_to_be_none() -> None:
    assert "no number" in said(Cause.NOT_A_NUMBER)

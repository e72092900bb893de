"""Questions to participants, as data of the bus: consent, unweighted NASA-TLX, rating scales and choices."""

from typing import Any

import msgspec

from telenano_lab.experiments.extend import choice, scale
from telenano_lab.experiments.messages import Question

CONSENT_TEXT = (
    "You take part of your own will, and may end it at any time without giving a reason: say so, or close the page. "
    "What you do and answer is recorded under a pseudonym, never under your name."
)


CONSENT = choice("consent", "Do you agree to take part?", ("yes", "no"))


def worded(question: Question, text: str, low: str = "", high: str = "", options: tuple[str, ...] = ()) -> Question:
    """Return a question in other words; empty arguments leave the original text."""
    own: dict[str, Any] = {"text": text, "low": low, "high": high, "options": options}
    return msgspec.structs.replace(question, **{key: value for key, value in own.items() if value})


def _load(name: str, text: str, low: str = "Very low", high: str = "Very high") -> Question:
    return scale(name, text, low, high, 0.0, 100.0, 5.0)


# Hart and Staveland, Advances in Psychology 52, 139-183 (1988): six scales of 21 gradations. Raw, without the weights:
# Hart, Proc. Human Factors and Ergonomics Society 50, 904-908 (2006).
NASA_TLX = (
    _load("mental_demand", "How mentally demanding was the task?"),
    _load("physical_demand", "How physically demanding was the task?"),
    _load("temporal_demand", "How hurried or rushed was the pace of the task?"),
    _load("performance", "How successful were you in what you were asked to do?", "Perfect", "Failure"),
    _load("effort", "How hard did you have to work to reach your level of performance?"),
    _load("frustration", "How insecure, discouraged, irritated, stressed and annoyed were you?"),
)
# Questionnaires that an experiment's file can name.
INSTRUMENTS: dict[str, tuple[Question, ...]] = {"nasa_tlx": NASA_TLX, "consent": (CONSENT,)}

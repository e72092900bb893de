"""What was found of a motion, and why, as values: `telenano.analysis.verdict_sentences` puts them into words."""

from enum import Enum, auto
from typing import Literal, NamedTuple

Kind = Literal["stable", "limit_cycle", "diverged", "contact_lost", "guarded", "no_data", "cannot_say"]


class Cause(Enum):
    """Why a verdict is what it is."""

    NOT_A_NUMBER = auto()
    FEW_SAMPLES = auto()
    HIDDEN_BY_NOISE = auto()
    LIKE_NOISE = auto()
    ON_ITS_WAY = auto()
    CHANGE_UNKNOWN = auto()
    IRREGULAR_UNKNOWN = auto()
    WITHIN_A_STEP = auto()
    GROWS = auto()
    GOES_ON = auto()
    IRREGULAR = auto()
    AT_REST = auto()
    DIES_OUT = auto()
    MOVED = auto()
    TO_THE_REST = auto()


class Finding(NamedTuple):
    """What was found of a motion, before it is put into words.

    size_n: of the motion at its end [N]; decisive_n: of the mode that decides [N], with its growth [1/s], the standard
    error of that and its frequency [Hz], 0 of one without a swing, None of an envelope; needs_s, needs_noise_n: the
    length of a hold, and the noise, that would decide.
    """

    kind: Kind
    cause: Cause
    size_n: float = 0.0
    growth_per_s: float | None = None
    decisive_n: float = 0.0
    error_per_s: float = 0.0
    frequency_hz: float | None = None
    needs_s: float = 0.0
    needs_noise_n: float = 0.0
    rest_from_s: float | None = None
    samples: int = 0


def on_its_way(found: Finding, way_n: float, needs_s: float) -> Finding:
    """Return that a force was on its way, how far it went [N], and which hold would decide [s]."""
    return found._replace(kind="cannot_say", cause=Cause.ON_ITS_WAY, decisive_n=way_n, needs_s=needs_s)

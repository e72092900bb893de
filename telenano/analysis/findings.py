"""Findings on a motion and their causes, as values; `telenano.analysis.verdict_sentences` puts them into words."""

from enum import Enum, auto
from typing import Literal, NamedTuple

Kind = Literal["stable", "limit_cycle", "diverged", "contact_lost", "guarded", "no_data", "cannot_say"]


class Cause(Enum):
    """Cause of a finding."""

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
    GROWS_SMALL = auto()


class Finding(NamedTuple):
    """A finding on a motion, before it is put into words.

    size_n: size of the motion at its end [N]; decisive_n: size of the mode that decides [N], with its growth [1/s], the
    standard error of that [1/s] and its frequency [Hz], 0 for one without a swing, None for an envelope; needs_s,
    needs_noise_n: the length of a hold [s], and the noise [N], that would decide; rest_from_s: start of the rest [s],
    None without one; samples: their number, if they are too few; band_hz: the band that has
    most of the power of a motion without a line [Hz].
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
    band_hz: tuple[float, float] = (0.0, 0.0)


def on_its_way(found: Finding, way_n: float, needs_s: float) -> Finding:
    """Return the finding that a force was on its way, by way_n [N]; a hold of needs_s [s] would decide."""
    return found._replace(kind="cannot_say", cause=Cause.ON_ITS_WAY, decisive_n=way_n, needs_s=needs_s)

"""Sentences for findings on a motion; for an undecided one they state what would decide it."""

from telenano.analysis.findings import Cause, Finding
from telenano.analysis.modes import LEAST_SAMPLES


def sentence(found: Finding, noise_n: float) -> str:
    """Return a finding in words; noise_n: the standard deviation of the noise of the read-out [N]."""
    moved, rate = f"{found.decisive_n:.3g} N", found.growth_per_s or 0.0
    turns = f" at {found.frequency_hz:.3g} Hz" if found.frequency_hz else ""
    swing = f"{moved} to one side" if found.frequency_hz == 0.0 else f"{moved} from peak to peak{turns}"
    left = f", {found.decisive_n:.2g} N are left" if found.decisive_n >= 1e-6 else ""
    less = f" or noise of less than {found.needs_noise_n:.2g} N" if found.needs_noise_n else ""
    cycle = f"a motion of {found.size_n:.3g} N from peak to peak"
    few = f"a motion of {found.size_n:.2g} N: a longer hold" if found.samples >= LEAST_SAMPLES else "it"
    band = f" between {found.band_hz[0]:.2g} and {found.band_hz[1]:.2g} Hz" if found.band_hz[1] else ""
    sentences = {
        Cause.NOT_A_NUMBER: "the force is no number from some time on",
        Cause.FEW_SAMPLES: f"{found.samples} samples were taken of {few}"
        + (" would decide" if few != "it" else f": {LEAST_SAMPLES} or more would decide"),
        Cause.HIDDEN_BY_NOISE: f"noise of {noise_n:.2g} N hides what moves: a read-out with less than "
        f"{found.needs_noise_n:.2g} N would decide",
        Cause.LIKE_NOISE: f"{cycle} has no line and falls with the frequency as 1/f noise does: a read-out and a hand "
        "with less would decide",
        Cause.ON_ITS_WAY: f"the force was on its way, {moved}: a hold of {found.needs_s:.2g} s or more would decide",
        Cause.CHANGE_UNKNOWN: f"a motion of {swing} changes by {rate:.2g} ± {found.error_per_s:.2g}/s: a hold of "
        f"{found.needs_s:.2g} s or more{less} would decide",
        Cause.IRREGULAR_UNKNOWN: f"{cycle} continues irregularly: a longer hold would decide",
        Cause.WITHIN_A_STEP: f"{cycle} is no larger than a step of the read-out: steps of less than "
        f"{found.needs_noise_n:.2g} N would decide",
        Cause.GROWS: f"a motion of {swing} grows by {rate:.3g}/s",
        Cause.GOES_ON: f"{cycle}{turns} neither grows nor dies out",
        Cause.IRREGULAR: f"{cycle} continues irregularly{band}",
        Cause.AT_REST: f"at rest but for {found.decisive_n:.2g} N from peak to peak" if found.decisive_n else "at rest",
        Cause.GROWS_SMALL: f"at rest but for {swing}, which grows by {rate:.3g}/s and is still small",
        Cause.DIES_OUT: f"the motion dies out by {-rate:.3g}/s{left}",
        Cause.MOVED: f"nothing swings, and the force moves by {found.decisive_n:.2g} N to one side",
        Cause.TO_THE_REST: f"the force goes to the rest of the law, {found.decisive_n:.2g} N are left",
    }
    return sentences[found.cause]

"""Fifty particles make no message of 1 kHz late: rigs with them and without, in turns."""

from itertools import pairwise
from pathlib import Path
from statistics import median

import machine
import pytest
from stack_rig import Rig

pytestmark = pytest.mark.endurance

TURNS = 5
# A machine that is late by itself so often says nothing of particles.
BUSY = 0.05
FLAT = ("--duration", "5", "--set", "afm_node.sample.size_m=24e-6", "--set")
RIGS = {0: (*FLAT, "afm_node.sample.particles=null"), 50: (*FLAT, "afm_node.sample.particles.count=50")}


def late_share(folder: Path, words: tuple[str, ...]) -> float:
    """Return the share of the samples of hand and tip that came more than 1.5 ms after the one before."""
    rig = Rig(folder)
    try:
        rig.run(*words, scenario="assembly")
        gaps_ns = [
            b.publish_ns - a.publish_ns
            for topic in ("haptic/state", "afm/state")
            for a, b in pairwise(rig.recording().messages(topic))
        ]
    finally:
        rig.close()
    assert len(gaps_ns) > 6000
    return sum(gap > 1_500_000 for gap in gaps_ns) / len(gaps_ns)


def test_fifty_particles_make_no_message_late(tmp_path: Path) -> None:
    shares: dict[int, list[float]] = {count: [] for count in RIGS}
    for turn in range(TURNS):
        for count in sorted(RIGS, reverse=bool(turn % 2)):
            shares[count].append(late_share(tmp_path / f"{turn}-{count}", RIGS[count]))
    without, with_them = median(shares[0]), median(shares[50])
    if without > BUSY:
        machine.note(f"of a rig without particles {without:.1%} of the messages were late: 50 were not judged")
        return
    # A node whose step takes longer than its period is late with each message.
    assert with_them <= 3.0 * without + 0.02, shares

"""Journals of simulated experiments with a known effect, for tests of tables and analysis."""

import random
from collections.abc import Mapping
from typing import Any

LAWS, DELAYS_MS = ("virtual_impedance", "wave"), (0.0, 40.0, 80.0)
# Completion time per delay [s/ms]: mean, and deviation over participants.
SLOPE, SLOPE_SPREAD = 0.02, 0.004


def trial(participant: str, index: int, condition: Mapping[str, Any], **measures: Any) -> dict[str, Any]:
    """Return the record of a completed trial."""
    return {
        "record": "trial", "utc": "2026-11-22T10:00:00.000+00:00", "participant": participant, "session": 1, "block": 0,
        "index": index, "attempt": 0, "phase": "main", "task": "touch_and_hold", "seed": index, "status": "done",
        "final": True, "disturbance": "", "started_utc": "2026-11-22T10:00:00.000+00:00", "duration_s": 9.5,
        "recording": "", "condition": dict(condition), "settings": {}, "measures": measures, "answers": [],
        "verified": {},
    }  # fmt: skip


def demo(seed: int, participants: int = 4, repetitions: int = 3) -> list[dict[str, Any]]:
    """Return a journal of 2 laws x 3 delays x repetitions, whose completion time grows with the delay."""
    source = random.Random(seed)
    records = []
    for number in range(participants):
        own = source.gauss(2.0, 0.4)
        slope = source.gauss(SLOPE, SLOPE_SPREAD)
        cells = [(law, delay) for law in LAWS for delay in DELAYS_MS for _ in range(repetitions)]
        source.shuffle(cells)
        for index, (law, delay) in enumerate(cells):
            time_s = own + slope * delay + (0.3 if law == "wave" else 0.0) + source.gauss(0.0, 0.25)
            # A force of nanonewtons, which the analysis must not treat as zero.
            error_n = 1e-9 * (1.0 + abs(source.gauss(0.0, 0.2)))
            condition = {"law": law, "delay_ms": delay}
            records.append(
                trial(
                    f"P{number + 1:02d}",
                    index,
                    condition,
                    completion_time_s=time_s,
                    force_error_n=error_n,
                    success=time_s < 4.5,
                )
            )
    return records

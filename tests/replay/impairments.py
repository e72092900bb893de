"""One cell for each kind of impairment that the link has, for the lockstep loop, the virtual rig and the bus.

A kind is the settings of the hand's signals forward; all else has a constant delay. Each session is compared with the
lockstep loop over the losses and delays that its recording has (`telenano_lab.studies.loops.recorded_link`).
"""

from pathlib import Path
from typing import Any

import numpy as np
from telenano_lab.studies.loops.cells import Cell, CellResult, judged, rig_of, settle_ticks
from telenano_lab.studies.loops.recorded_link import recorded_schedule
from telenano_lab.studies.loops.validate import read_course, scenario_of

ONE_WAY_S = 0.01
# The verdict is that of both, and so is the greatest force, within this share.
FORCE_SHARE = 0.05
# Where less moves than this share of the hand's 1 N, a growth of it decides nothing.
QUIET_SHARE = 0.05
# name: settings of the direction beside its delay, as keys of the link
KINDS: dict[str, dict[str, Any]] = {
    "delay_s": {"delay_s": 0.02},
    "jitter": {"jitter": {"scale_s": 0.005, "distribution": "uniform"}},
    "jitter in order": {"jitter": {"scale_s": 0.005, "distribution": "uniform"}, "order": "topic"},
    "delay_trace": {"delay_trace": {"file": "delay.txt"}},
    "loss": {"loss": {"probability": 0.2}},
    "loss_trace": {"loss_trace": {"file": "loss.txt"}},
    "markov_loss": {"markov_loss": {"p13": 0.02, "p31": 0.2, "p32": 0.2, "p23": 0.3, "p14": 0.05}},
    "gilbert_elliott": {"gilbert_elliott": {"p": 0.02, "r": 0.1}},
    # so many that a reader refuses each: one flipped bit may leave a message that can be read, with a wrong number
    "corruption": {"corruption": {"probability": 0.1, "bits": 400}},
    "duplication": {"duplication": {"probability": 0.2}, "jitter": {"scale_s": 0.002, "distribution": "uniform"}},
    "reordering": {"reordering": {"probability": 0.2, "gap": 3}},
    "rate and queue": {"rate": {"rate_bytes_per_s": 250e3}, "queue": {"limit_messages": 20, "drop": "head"}},
    "delivery_trace": {"delivery_trace": {"file": "delivery.txt", "unit_s": 1e-4, "bytes_per_opportunity": None}},
    "slots": {"slots": {"min_interval_s": 0.03}},
    "slots that carry little": {"slots": {"min_interval_s": 0.02, "max_messages": 15}},
    "outage that drops": {"outage": {"schedule": [[0.1, 0.04]], "period_s": 0.3, "mode": "drop"}},
    "outage that holds": {"outage": {"schedule": [[0.1, 0.04]], "period_s": 0.3, "mode": "hold"}},
    "a share of the messages": {"apply_probability": 0.5, "loss": {"probability": 0.4}},
}


def write_traces(folder: Path) -> None:
    """Write the traces that the kinds name: a sawtooth of the delay, gaps of 20 ms, bursts 100 us apart after 60 ms."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "delay.txt").write_text("0 0\n0.05 0.03\n0.051 0\n0.1 0.03\n0.101 0\n", encoding="utf-8")
    (folder / "loss.txt").write_text("0 0\n0.08 1\n0.1 0\n0.2 1\n0.205 0\n0.3 0\n", encoding="utf-8")
    write_bursts(folder / "delivery.txt", 60)


def write_bursts(path: Path, messages: int) -> None:
    """Write the opportunities of bursts of some messages, 100 us apart, after a pause: one for each ms, unit 0.1 ms."""
    path.write_text("".join(f"{9 * messages + n}\n" for n in range(1, messages + 1)), encoding="utf-8")


def direction_of(kind: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the settings of a direction that has a kind on the signals of the hand, with its traces in a folder."""
    section = {
        key: {**value, "file": str(folder / value["file"])} if isinstance(value, dict) and "file" in value else value
        for key, value in kind.items()
    }
    return {"delay_s": ONE_WAY_S, "topics": {"teleop/forward": section}}


def cell_of(law: str, stiffness: float, session_s: float = 1.7) -> Cell:
    """Return a cell on a spring [N/m] of such a length [s]."""
    return Cell(
        law=law, environment="spring", round_trip_ms=2e3 * ONE_WAY_S, stiffness_n_per_m=stiffness, session_s=session_s
    )


def scenario_over(cell: Cell, direction: dict[str, Any]) -> dict[str, Any]:
    """Return the scenario of a cell over a link with such a direction forward."""
    scenario = scenario_of(cell)
    return {**scenario, "delay_node": {"seed": 5, "forward": direction, "backward": {"delay_s": ONE_WAY_S}}}


def outcomes(cell: Cell, recording: Path) -> tuple[CellResult, CellResult]:
    """Return what became of a cell in a recording over a kind of link, and in lockstep over the link that it had."""
    rig = rig_of(cell, cell.hand_points())
    settle = settle_ticks(cell, rig.period_s)
    ticks = settle + round(cell.hold_s()[1] / rig.period_s)
    expected = rig.run(recorded_schedule(recording, settle, ticks, rig.period_s), settle)
    return judged(cell, read_course(recording)), judged(cell, expected)


def fault_of(found: CellResult, expected: CellResult) -> str:
    """Return in what two outcomes differ, in words; empty where they agree."""
    assert found.peak_n is not None
    assert expected.peak_n is not None
    quiet = max(found.peak_to_peak_n, expected.peak_to_peak_n) < QUIET_SHARE
    if found.verdict != expected.verdict and not quiet:
        return f"{found.verdict} ({found.reason}) and not {expected.verdict} ({expected.reason})"
    if not np.isclose(found.peak_n, expected.peak_n, rtol=FORCE_SHARE, atol=0.0):
        return f"a greatest force of {found.peak_n:.3f} and not {expected.peak_n:.3f} N"
    return ""

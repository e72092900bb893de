"""What disturbs a trial is told from what its condition does, by the truth of the link, case by case."""

from typing import Any

import numpy as np
import pytest
from telenano_lab.experiments.disturbances import Evidence, Hold, Passage, disturbances, longest_gap

STALL_S = 0.02
TIMES = np.arange(0.0, 4.0, 1e-3)


def steps(at_s: float | None = None, long_s: float = 0.0) -> Any:
    found = np.column_stack((TIMES, np.full(TIMES.size, 1e-3)))
    if at_s is not None:
        found[round(1e3 * at_s), 1] = long_s
    return found


def passage(
    delay_s: float = 0.0, silent: tuple[float, float] = (0.0, 0.0), lost: tuple[float, float] = (0.0, 0.0)
) -> Any:
    """Return a direction that nothing reached in one interval, and that delivered nothing of another."""
    arrived = TIMES[(silent[0] >= TIMES) | (silent[1] <= TIMES)]
    kept = arrived[(arrived <= lost[0]) | (arrived >= lost[1])]
    return Passage(arrived, kept + delay_s)


def evidence(**changes: Any) -> Evidence:
    fields = {"duration_s": 4.0, "hand_s": steps(), "tip_s": steps(), "forward": passage(), "backward": passage()}
    return Evidence(**{**fields, **changes})


HELD = Hold(2.1, "afm_node@slave", "command_deadline")

OUTCOMES = {
    "nothing": {},
    "a delay of a second": {"forward": passage(1.0), "backward": passage(1.0)},
    "an outage of the link, in which the instrument holds": {
        "forward": passage(lost=(2.0, 2.6)),
        "backward": passage(lost=(2.0, 2.6)),
        "holds": [
            HELD,
            Hold(2.15, "haptic_node@master", "no command within the deadline: off until commands are fresh"),
        ],
    },
    "a burst of losses on the way back alone": {
        "backward": passage(lost=(2.0, 2.2)),
        "holds": [Hold(2.12, "haptic_node@master", "no command within the deadline: off until commands are fresh")],
    },
    "an answer that stops with what was asked": {
        "forward": passage(lost=(2.0, 2.4)),
        "backward": passage(silent=(2.0, 2.4)),
    },
    "too much force, for which the guard withdraws": {"holds": [Hold(2.0, "afm_node@slave", "force_limit")]},
    "a dead band that keeps signals back": {"forward": passage(silent=(1.0, 1.09)), "quiet_s": 0.1},
    "a hold before the trial began": {"holds": [Hold(-0.4, "haptic_node@master", "no command within the deadline")]},
    "a jitter of a few periods": {"hand_s": steps(1.0, 0.015), "tip_s": steps(2.0, 0.012)},
}


@pytest.mark.parametrize("case", OUTCOMES)
def test_what_the_condition_causes_is_an_outcome(case: str) -> None:
    assert disturbances(evidence(**OUTCOMES[case]), STALL_S) == []


DISTURBED = {
    "a stall of the hand's process": (
        {"hand_s": steps(1.5, 0.08)},
        "the hand's device stood still for 80 ms at 1.50 s",
    ),
    "a stall of the instrument's": ({"tip_s": steps(2.5, 0.021)}, "the instrument stood still for 21 ms at 2.50 s"),
    "a stall of the master half": (
        {"forward": passage(silent=(1.0, 1.3))},
        "nothing of the hand reached the link for 300",
    ),
    "a stall of the slave half, while the link delivered": (
        {"backward": passage(silent=(1.0, 1.3))},
        "nothing of the tip reached the link for 300",
    ),
    "an instrument that held although the link delivered": ({"holds": [HELD]}, "afm_node@slave held at 2.10 s"),
    "a hold long after an outage": (
        {"forward": passage(lost=(0.5, 0.8)), "holds": [HELD]},
        "although the link had delivered",
    ),
    "an emergency stop": (
        {"estops": [("haptic_node@master", 1.25)]},
        "haptic_node@master was in emergency stop at 1.25 s",
    ),
    "a node that was started again": ({"restarted": ["controller@slave"]}, "controller@slave was started again"),
    "a device that was lost": ({"holds": [Hold(2.0, "afm_node@slave", "device_lost")]}, "lost its device at 2.00 s"),
    "a fault that a node calls an error": ({"faults": ["recorder@master: disk full"]}, "disk full"),
    "a recording that is not whole": (
        {"missing": ["7 messages of afm/state are missing"]},
        "the recording is not whole: 7",
    ),
    "a device that says nothing": ({"tip_s": np.empty((0, 2))}, "the instrument reported nothing"),
    "a dead band that is not an excuse for a longer silence": (
        {"forward": passage(silent=(1.0, 1.2)), "quiet_s": 0.1},
        "nothing of the hand reached the link for 200 ms",
    ),
    "an outage is not an excuse for a stall in it": (
        {"forward": passage(lost=(2.0, 2.6)), "hand_s": steps(2.2, 0.05), "holds": [HELD]},
        "the hand's device stood still for 50 ms",
    ),
}


@pytest.mark.parametrize("case", DISTURBED)
def test_what_the_link_cannot_explain_disturbs(case: str) -> None:
    changes, sentence = DISTURBED[case]
    found = disturbances(evidence(**changes), STALL_S)
    assert any(sentence in text for text in found), found


def test_the_longest_gap_counts_the_ends() -> None:
    assert longest_gap(np.array([1.0, 1.5]), 0.0, 4.0) == (2.5, 1.5)
    assert longest_gap(np.empty(0), 1.0, 4.0) == (3.0, 1.0)

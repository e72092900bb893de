"""The project's judge on a course of the corpus, through the functions that judge a recording.

    judge_course(course(7))

A course states what a recording states: series of hand and tip, what the instrument says, the plan of the holds, and
when link, machine, operator and guard did something. Here it gets the names that `telenano.analysis.holds` has for
these.
"""

from typing import Any, NamedTuple

import numpy as np

from telenano.analysis.holds import Guard, Hold, Instrument, Late, SessionContext, judge_holds
from telenano.analysis.interruptions import DEADLINE, Interruption, ModeReport, interruptions_of

# the deadline of both devices by default [s]
DEADLINE_S = 0.05


class Judged(NamedTuple):
    """The verdict on the hold that the truth of a course is about, and its words."""

    kind: str
    reason: str


def judge_course(course: Any) -> Judged:
    """Return the verdict on the last hold of a course."""
    found = hold_of(course)
    return Judged("cannot_say", "there is no hold") if found is None else Judged(found.verdict, found.reason)


def hold_of(course: Any) -> Hold | None:
    """Return the last planned hold of a course, judged; None where there is none."""
    tip = Instrument(course.following | course.held, course.in_contact, course.held)
    found = judge_holds(course.time_s, course.hand_force_n, course.time_s, course.tip_force_n, tip, _programme(course))
    start_s, end_s, _ = course.planned[-1]
    inside = [hold for hold in found if min(hold.end_s, end_s) > max(hold.start_s, start_s)]
    return max(inside, key=lambda hold: min(hold.end_s, end_s) - max(hold.start_s, start_s), default=None)


def _programme(course: Any) -> SessionContext:
    """Return what a recording of the course would say besides its series."""
    late = [Late(at_s, DEADLINE_S) for at_s in course.overruns]
    late += [Late(start, end - start) for start, end, cause in course.interruptions if cause == "machine"]
    # a device says that it is held when it is, and why
    told = [
        ModeReport(
            start + (0.0 if cause == "operator" else DEADLINE_S), "hold", DEADLINE if cause != "operator" else "asked"
        )
        for start, _, cause in course.interruptions
    ]
    interruptions: list[Interruption] = interruptions_of("tip_held", course.time_s, course.held, told)
    # every sample is answered a round trip later, but for those that an open loop loses
    answered = np.ones(len(course.time_s), dtype=bool)
    for start, end, cause in course.interruptions:
        if cause != "operator":
            answered &= (course.time_s <= start) | (course.time_s >= end)
    guards = [] if course.guard is None else [Guard(course.guard[0], _reason(course.guard[1]))]
    return SessionContext(
        planned=course.planned,
        answered_s=course.time_s[answered] + course.round_trip_s,
        guards=guards,
        interruptions=interruptions,
        late=sorted(late),
        deadline_s=DEADLINE_S,
        transit_s=course.round_trip_s,
        rest_force=None if course.rest_force_n is None else lambda force_n: float(course.rest_force_n),
    )


def _reason(words: str) -> str:
    return "hold_expired" if words.startswith("no command") else "force_limit"

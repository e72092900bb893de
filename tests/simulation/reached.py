"""Situations that a night of schedules has to reach, each told by what the files show and not by what was intended."""

from collections.abc import Callable
from outside_judge import HAND, TIP, Session

def situations(session: Session) -> frozenset[str]:
    return frozenset()

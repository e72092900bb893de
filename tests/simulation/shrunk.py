"""Reduction of a schedule that breaks an invariant to few events that break the same one (delta debugging)."""

from collections.abc import Callable, Sequence

from fault_schedule import Event, Schedule

# Greatest number of events with which a failure should be reported.
MOST_EVENTS = 5
Breaks = Callable[[Schedule], bool]


def shrunk(schedule: Schedule, breaks: Breaks, *, most_tries: int = 60) -> Schedule:
    """Return the schedule with a minimal set of events that still breaks the invariant.

    Args:
        schedule: A schedule that breaks it.
        breaks: Returns whether a schedule breaks it.
        most_tries: The number of tries after which the smallest schedule so far is returned.
    """
    tries = [0]

    def still(events: Sequence[Event]) -> bool:
        tries[0] += 1
        return tries[0] <= most_tries and breaks(schedule.with_events(events))

    return schedule.with_events(_fewest(list(schedule.events), still))


def _fewest(events: list[Event], still: Callable[[Sequence[Event]], bool]) -> list[Event]:
    """Return a minimal subset that still breaks: leave out halves first, then smaller parts, at last single events."""
    parts = 2
    while len(events) >= 2:
        size = max(1, -(-len(events) // parts))
        places = range(0, len(events), size)
        left_out = next((rest for at in places if still(rest := events[:at] + events[at + size :])), None)
        if left_out is not None:
            events, parts = left_out, max(parts - 1, 2)
        elif size == 1:
            break
        else:
            parts = min(len(events), 2 * parts)
    return [] if events and still([]) else events

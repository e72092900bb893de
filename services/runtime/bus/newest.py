"""Of the messages of a `latest` topic that wait together, the newest of each source."""

from collections import Counter
from collections.abc import Callable, Container, Sequence

from proto.sequence import Arrival, SequenceTracker

# frames of a message, and the time of reception [ns]
Taken = tuple[Sequence[bytes], int]
# the sequence statistics of its source, seq, t_ns
Header = tuple[SequenceTracker, int, int]


def without_superseded(
    waiting: Sequence[Taken], latest: Container[bytes], header_of: Callable[[Sequence[bytes]], Header | None]
) -> Sequence[Taken]:
    """Return what waits without the messages that a newer one of their source stands behind.

    Those are tracked by their header, and counted as superseded. The rest stays in its order and is judged as ever:
    what is late or repeated, has no good header, or is the first from its source.

    Args:
        waiting: The messages that wait, in their order.
        latest: The topics concerned.
        header_of: Returns the header, or None for a message that is left alone.
    """
    topics = [frames[0] for frames, _ in waiting]
    if len(set(topics)) == len(topics):
        return waiting
    crowded = {topic for topic, count in Counter(topics).items() if count > 1 and topic in latest}
    newest: dict[SequenceTracker, tuple[int, int, int]] = {}
    superseded: set[int] = set()
    for place, (frames, _) in enumerate(waiting):
        header = header_of(frames) if frames[0] in crowded else None
        if header is None:
            continue
        tracker, seq, t_ns = header
        before = newest.get(tracker)
        if before is not None:
            older, older_seq, older_t_ns = before
            if seq <= older_seq and t_ns <= older_t_ns:
                continue
            superseded.add(older)
            arrival = tracker.accept(older_seq, older_t_ns)
            tracker.superseded += arrival not in (Arrival.DUPLICATE, Arrival.LATE)
        newest[tracker] = (place, seq, t_ns)
    return [taken for place, taken in enumerate(waiting) if place not in superseded]

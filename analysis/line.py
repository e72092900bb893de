"""What the line between two sites carried in a session, by the reports of its ends (`link/network`)."""

from typing import Any

from recording.multi_file import RecordingSource
from recording.site_clock import Timeline
from services.runtime.datagram.rate import WARN_QUEUE_NS


def lines_of(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[dict[str, Any]]:
    """Return the figures of each direction while the session ran; none without reports of a queue."""
    reports: dict[str, dict[tuple[str, int], dict[str, Any]]] = {}
    for message in recording.select(lambda channel: channel.topic == "link/network"):
        if timeline.stamp_ns(message.src, start_ns) <= message.publish_ns <= timeline.stamp_ns(message.src, end_ns):
            fields = message.fields()
            # The report of the slave is in the master's recording twice, as it came and through the link.
            if fields.get("queue_s") is not None:
                reports.setdefault(str(fields["direction"]), {})[message.src, message.seq] = fields
    return [_figures(way, list(found.values())) for way, found in sorted(reports.items(), reverse=True)]


def _figures(direction: str, reports: list[dict[str, Any]]) -> dict[str, Any]:
    first, last = reports[0], reports[-1]
    queues_ms = [1e3 * report["queue_s"] for report in reports]
    settled, lost = last["settled"] - first["settled"], max(0, last["lost"] - first["lost"])
    capacity = last.get("capacity_bit_per_s")
    return {
        "direction": direction,
        "queue_max_ms": round(max(queues_ms), 2),
        "full_share": round(sum(queue > WARN_QUEUE_NS * 1e-6 for queue in queues_ms) / len(queues_ms), 3),
        "capacity_mbit": None if capacity is None else round(capacity * 1e-6, 3),
        "datagrams_per_s": round((last["sent"] - first["sent"]) / max(1e-9, (last["t_ns"] - first["t_ns"]) * 1e-9), 1),
        "lost_share": round(min(1.0, lost / settled), 4) if settled > 0 else None,
    }

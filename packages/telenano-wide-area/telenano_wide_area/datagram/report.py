"""The report of an end on the network: counts, and the fate of each datagram since the last report."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from telenano.timing import OffsetFilter
from telenano.wire import Array
from telenano_wide_area.datagram.arrivals import ArrivalRecord
from telenano_wide_area.datagram.full_queue import Measured
from telenano_wide_area.datagram.outgoing import Outgoing


def network_report(
    ways: Mapping[str, str],
    offset: OffsetFilter,
    arrivals: ArrivalRecord,
    outgoing: Outgoing,
    carries: Measured | None,
) -> dict[str, Any]:
    """Return the fields of link/network for the direction that an end receives.

    Args:
        ways: The direction, and how it is received and the other one sent.
        offset: The offset of the other end's clock.
        arrivals: The datagrams of the direction; their fates are taken out.
        outgoing: The other direction.
        carries: The capacity of the line to here, None until it is known.
    """
    fates, queue = arrivals.take_fates(), outgoing.line.take_back()
    # The times of sending are by the other clock, whose lead is corrected here.
    clock = offset.report()
    ahead_ns = round(clock.offset_s * 1e9)
    lost = np.frombuffer(fates.lost, dtype="u1") if fates.lost else np.zeros(0, dtype="u1")
    raw_ns = np.array(fates.raw_ns, dtype="i8")
    valid = clock.valid and bool((lost == 0).any())
    delay_ns = np.where(lost == 0, np.maximum(raw_ns + ahead_ns, 0), 0) if valid else np.zeros_like(raw_ns)
    arrived_s = delay_ns[lost == 0] * 1e-9
    rows = {
        "number": np.array(fates.number, dtype="i8"),
        "arrived_ns": np.array(fates.arrived_ns, dtype="i8"),
        "delay_ns": delay_ns,
        "lost_flag": lost,
    }
    if ways["direction"] == "forward" and outgoing.control.mode != "free":
        # This report crosses the full line, and its rows would take a fifth of 1 Mbit/s.
        rows = {name: column[:0] for name, column in rows.items()}
    return {
        **ways,
        "sent": arrivals.sent,
        "arrived": arrivals.arrived,
        "late": arrivals.late,
        "lost": max(0, arrivals.lost),
        "settled": arrivals.settled,
        "repeats": outgoing.repeats.count,
        "unsent": outgoing.unsent,
        "sent_bytes": outgoing.bytes,
        "queue_s": None if queue is None else queue.queue_ns * 1e-9,
        "queue_low_s": None if queue is None else queue.low_ns * 1e-9,
        "queue_high_s": None if queue is None else queue.high_ns * 1e-9,
        "capacity_bit_per_s": None if carries is None else carries.bit_per_s,
        "capacity_low_bit_per_s": None if carries is None else carries.low_bit_per_s,
        "capacity_high_bit_per_s": None if carries is None else carries.high_bit_per_s,
        "line": outgoing.control.mode,
        "limit_bit_per_s": round(8.0 * outgoing.control.bytes_per_s),
        "delay_valid": valid,
        "delay_min_s": float(arrived_s.min()) if valid else 0.0,
        "delay_mean_s": float(arrived_s.mean()) if valid else 0.0,
        "delay_max_s": float(arrived_s.max()) if valid else 0.0,
        "clock": clock,
        **{name: Array.from_numpy(column) for name, column in rows.items()},
    }

"""Two machines with a narrow line between them: named, measured, adapted to, or refused."""

import json
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import machine
import pytest
from ledger import record
from two_sites import TwoSites, needs_namespaces
from wide_area_cable import ENDS, EXCLUDED, WideAreaCable, distorted, lateness

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(300)]

MBIT = 1_000_000.0
DELAY_S = 0.02
NS_PER_S = 1_000_000_000
# So much more than the delay of the line a datagram may take on the mean.
MORE_MS = 10.0
# The recorder of the master takes nothing that the slave's nodes send a thousand times a second.
LEAN = {"master": [*EXCLUDED["master"], "afm/*", "node/journal*"], "slave": EXCLUDED["slave"]}


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[tuple[TwoSites, WideAreaCable]]:
    cable = WideAreaCable(DELAY_S, 0.0)
    found = TwoSites(tmp_path, cable=cable)
    yield found, cable
    found.close()


def start(sites: TwoSites, duration_s: float) -> None:
    """Start both sites under the law of waves."""
    for site in (sites.slave, sites.master):
        chosen = ["--set", "controller.law=wave", "--set", f"recorder.exclude={json.dumps(LEAN[site.name])}"]
        site.rate = ()
        site.start(*chosen, *(("--duration", str(duration_s)) if site is sites.master else ()))


def reports(sites: TwoSites, direction: str, since_ns: int = 0) -> list[dict[str, Any]]:
    """Give the reports of a direction since a time, of the recording of the site that receives it."""
    site = sites.slave if direction == "forward" else sites.master
    found = site.recording().messages("link/network", since_ns)
    return [message.fields() for message in found if message.src == ENDS[site.name]]


def test_a_line_that_becomes_narrow_is_named_and_its_queue_goes(rig: tuple[TwoSites, WideAreaCable]) -> None:
    sites, cable = rig
    start(sites, 600.0)
    sites.wait_until(sites.running, "a running session")
    # the slave's recorder begins a file with the session
    sites.wait_until(lambda: bool(reports(sites, "forward")), "a report of the slave's end")
    wide = reports(sites, "forward")[-1]
    assert wide["capacity_bit_per_s"] > 10 * MBIT
    before, begin_ns = cable.change(rate_bit_per_s=MBIT), time.time_ns()
    sites.wait_until(
        lambda: any(report["line"] == "full" for report in reports(sites, "backward", begin_ns)), "a full line"
    )
    # the queue of the first moments is 64 kB at the most, half a second of this line
    time.sleep(8.0)
    calm_ns = time.time_ns()
    time.sleep(5.0)
    late = lateness(cable.change(), before, begin_ns, time.time_ns())
    medians_ms: list[float] = []
    for direction in ("forward", "backward"):
        lately = reports(sites, direction, calm_ns)
        delays_ms = sorted(1e3 * report["delay_mean_s"] for report in lately if report["delay_valid"])
        median_ms = delays_ms[len(delays_ms) // 2]
        medians_ms.append(median_ms)
        if distorted(late) and median_ms >= 1e3 * DELAY_S + MORE_MS:
            machine.note(f"{direction}: {median_ms:.1f} ms over 1 Mbit/s: {distorted(late)}")
        else:
            assert median_ms < 1e3 * DELAY_S + MORE_MS
        sent = lately[-1]["sent"] - lately[0]["sent"]
        assert 50 * 4 <= sent < 900 * 5
        assert lately[-1]["receiving"] == "datagram"
    shown = sites.master.telenano("link", "show")
    assert shown.returncode == 0, shown.stderr
    assert "network: queue" in shown.stdout
    # What follows, such as the fetch of a recording, is no part of what is tried here.
    cable.change(rate_bit_per_s=0.0)
    sites.end_session()
    record(
        "the line becomes 1 Mbit/s in a session",
        f"one-way delay {max(medians_ms):.0f} ms over 20 ms, {sent / 5:.0f} samples a second",
    )


def test_a_line_without_room_for_a_session_is_refused(rig: tuple[TwoSites, WideAreaCable]) -> None:
    sites, cable = rig
    cable.change(rate_bit_per_s=0.256 * MBIT)
    start(sites, 5.0)
    assert sites.master.process is not None
    assert sites.master.process.wait(timeout=180.0) != 0
    said = sites.master.log.read_text()
    assert re.search(r"carries 0\.\d+ Mbit/s", said), said[-2000:]
    assert "a session needs 0.5 Mbit/s each way" in said
    record("a line of 256 kbit/s", "refused, with what the line carries and what a session needs")


def test_falling_back_to_tcp_stands_still_for_no_more_than_a_tenth_of_a_second(
    rig: tuple[TwoSites, WideAreaCable],
) -> None:
    sites, cable = rig
    start(sites, 600.0)
    sites.wait_until(sites.running, "a running session")
    time.sleep(2.0)
    before, begin_ns = cable.change(block_udp_there=True, block_udp_back=True), time.time_ns()
    sites.wait_until(lambda: sites.slave.has_log(ENDS["slave"], "continues over TCP"), "the slave to say so")
    time.sleep(0.5)
    end_ns = time.time_ns()
    late = lateness(cable.change(), before, begin_ns, end_ns)
    states = sites.slave.recording().messages("afm/state", begin_ns - NS_PER_S)
    longest_ms, newest, since_ns = 0.0, 0, 0
    for message in states:
        hand_ns = message.fields()["hand_t_ns"]
        if hand_ns > newest:
            if since_ns:
                longest_ms = max(longest_ms, (message.publish_ns - since_ns) * 1e-6)
            newest, since_ns = hand_ns, message.publish_ns
    assert longest_ms > 0.0
    record("UDP is blocked in a session, 20 ms each way", f"stood still for {longest_ms:.0f} ms")
    if distorted(late) and longest_ms > 100.0:
        machine.note(f"the tip stood still for {longest_ms:.0f} ms: {distorted(late)}")
    else:
        assert longest_ms <= 100.0
    sites.end_session()

"""Garbage at every endpoint that a program of the same user may take: no node ends, and a stop comes through."""

import time
from statistics import mean, median
from typing import Any

import machine
import pytest
import zmq
from empty_loop import EmptyLoops
from ledger import record
from neighbours import FLOOD_S, FREE, door, flood, garbage
from stack_rig import CONSTANT_PUSH, Rig

from telenano.recording.reader import Recording
from telenano.wire.nodes import START_ORDER

LOOPS = ("haptic_node@master", "controller@master", "controller@slave", "afm_node@slave")


@pytest.mark.endurance
def test_garbage_at_the_endpoints_that_are_open_to_others_ends_nothing(rig: Rig) -> None:
    rig.start("--duration", "300", "--set", CONSTANT_PUSH)
    rig.wait_until(rig.running, "a running session")
    before = {node: rig.process_of(node) for node in (*START_ORDER, "recorder@master")}
    inlets = sorted(path.name for path in rig.sockets.glob("*.estop"))
    assert len(inlets) == 4
    messages, sent_hz = garbage(500), []
    with zmq.Context[Any]() as context, EmptyLoops() as loops:
        first_ns = time.time_ns()
        for name in (*FREE, *inlets):
            with door(context, rig.sockets, name) as socket:
                sent_hz.append(flood(socket, messages))
        last_ns = time.time_ns()
        with door(context, rig.sockets, FREE[0]) as socket:
            flood(socket, messages)
            stopped = rig.telenano("estop")
        share = loops.share(first_ns, last_ns)
    assert stopped.returncode == 0, stopped.stderr
    assert {node: rig.process_of(node) for node in before} == before, rig.logs()
    assert not rig.log_has("launcher@master", "was started again")
    rig.stop()
    reports = [
        (message.src, message.fields())
        for message in Recording(rig.out / "session.mcap").messages(["node/health"])
        if first_ns <= message.publish_ns <= last_ns and message.src in LOOPS
    ]
    rates_hz = {node: mean(fields["rate_hz"] for src, fields in reports if src == node) for node in LOOPS}
    refused = max(sum(fields["rejected"].values()) for _, fields in reports)
    assert refused > 1000
    if share < 0.9:
        machine.note(f"garbage at free endpoints: {share:.0%} of the processors were to be had, no rate is judged")
        return
    assert min(rates_hz.values()) > 0.95 * share * 250.0, (rates_hz, share)
    record(
        "garbage at every endpoint that is open to others",
        f"{median(sent_hz):.0f} a second for {FLOOD_S:.0f} s at each of {len(sent_hz)}; no process ended; least rate "
        f"{min(rates_hz.values()) / 2.5:.1f} %; up to {refused} refused and counted by a node; both devices stopped",
    )

"""A frame that is too large, at an endpoint that any program of this user may take: every node hears its next owner.

The table of readers, publishers and ways to lose a connection is in `tests/unit/runtime/test_hearing.py`.
"""

import json
import time
from typing import Any

import pytest
import zmq
from ledger import record
from neighbours import door
from network_bench import payload
from stack_rig import CONSTANT_PUSH, Rig, mode

LARGE = bytes(20 << 20)
CONSOLE, BEACON, EVENTS = "console@master", "node/health", "session/event"
# Those of the site of the console that read its commands.
NODES = ("haptic_node@master", "controller@master", "delay_node@master", "recorder@master")
# The beacons of an endpoint that was taken come for this time before and after the frame [s].
SENT_S = 3.0


def send_beacons(socket: "zmq.Socket[Any]", name: str, first: int) -> int:
    """Send what every node sends twice a second; return the number of the next one."""
    begin_s, number = time.monotonic(), first
    while time.monotonic() < begin_s + SENT_S:
        socket.send_multipart([BEACON.encode(), payload(BEACON, name, number)])
        number += 1
        time.sleep(0.5)
    return number


def told(rig: Rig, name: str, state: str) -> dict[str, float]:
    """Return which nodes told that they were deaf to an endpoint, or hear it again (`up`), each with the time [s]."""
    events = [one.decode() for one in rig.recording().messages(EVENTS)]
    return {
        event.src: float(event.data["silent_s"])
        for event in events
        if event.kind == "network" and event.data.get("connection") == state and event.data["peer"] == name
    }


@pytest.mark.check("takes 40 s")
@pytest.mark.drawn(0.0, "telenano/runtime/bus/", "telenano/runtime/loop/")
def test_a_frame_that_is_too_large_makes_no_node_deaf_to_the_next_command(rig: Rig) -> None:
    rig.start("--duration", "300", "--set", CONSTANT_PUSH, rate=("--set", "realtime.rate_hz=250"))
    rig.wait_until(rig.running, "a running session")
    with zmq.Context[Any]() as context:
        with door(context, rig.sockets, CONSOLE) as socket:
            number = send_beacons(socket, CONSOLE, 0)
            for topic in (b"session/control", BEACON.encode()):
                socket.send_multipart([topic, LARGE])
            send_beacons(socket, CONSOLE, number)
        # One that has gone at once has nothing to be heard of.
        with door(context, rig.sockets, CONSOLE) as socket:
            time.sleep(0.3)
            socket.send_multipart([b"session/control", LARGE])
            time.sleep(0.3)
    marked = rig.telenano("session", "mark", "--json")
    assert marked.returncode == 0, marked.stdout + marked.stderr
    stopped = rig.telenano("session", "estop", "--json")
    assert stopped.returncode == 0, stopped.stdout + stopped.stderr
    rig.wait_until(lambda: mode(rig) == "estop", "the tip in emergency stop")
    again_s = told(rig, CONSOLE, "up")
    assert set(told(rig, CONSOLE, "deaf")) == set(again_s) >= set(NODES)
    state = json.loads(rig.telenano("status", "--json").stdout)
    assert not any(row["deaf_s"] for row in state["nodes"] if row["heard"])
    record(
        "a frame of 20 MB at the endpoint of a console",
        f"{len(again_s)} readers back after {max(again_s.values()):.1f} s at most",
    )

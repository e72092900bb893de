"""A link that stands still: what it holds is bounded and counted, and it can be set, stopped through and killed."""

import json
import time
from typing import Any

import pytest
from ledger import record
from stack_rig import BOTH_WAYS, Rig, arm, mode

STALL = ("forward.outage.schedule=0:600", "forward.outage.mode=hold", "forward.queue.limit_messages=100")


def forward(rig: Rig) -> dict[str, Any]:
    shown: dict[str, Any] = json.loads(rig.telenano("link", "show", "--json").stdout)["forward"]
    return shown


@BOTH_WAYS
# it kills a node of the rig, which no other test may find started again
@pytest.mark.check
@pytest.mark.drawn(0.0, "services/delay_node/", "telenano/link/")
def test_a_stalled_link_is_bounded_set_stopped_through_and_killed(pressing_rig: Rig) -> None:
    rig = pressing_rig
    if mode(rig) != "follow":
        arm(rig)
    assert rig.telenano("link", "set", *STALL).returncode == 0
    rig.wait_until(lambda: forward(rig)["dropped"].get("queue", 0) > 100, "a queue that is full")
    depth = forward(rig)["queue_depth"]
    # a hundred, and the commands of the session, which wait beyond the limit
    assert 100 <= depth < 150, depth
    rig.wait_until(lambda: mode(rig) == "retracted", "the tip withdrawn, for it has no commands")
    begin_ns = time.time_ns()
    sent = rig.telenano("session", "estop")
    assert sent.returncode == 0, sent.stderr
    rig.wait_until(lambda: mode(rig) == "estop", "the tip in emergency stop")
    stopped_ms = 1e-6 * next(
        found.publish_ns - begin_ns
        for found in rig.recording().messages("afm/state", begin_ns)
        if found.decode().mode == "estop"
    )
    assert forward(rig)["queue_depth"] >= 100, "the link does not stand still any more"

    # the line stands still on, and who sets it is obeyed
    assert rig.telenano("link", "set", "forward.queue.limit_messages=50").returncode == 0
    assert forward(rig)["settings"]["queue.limit_messages"] == 50
    dropped = forward(rig)["dropped"]["queue"]
    assert rig.telenano("link", "clear").returncode == 0
    arm(rig)

    assert rig.telenano("link", "set", *STALL).returncode == 0
    rig.wait_until(lambda: forward(rig)["queue_depth"] >= 100, "a queue that is full again")
    rig.kill("delay_node@master")
    rig.wait_until(lambda: rig.log_has("launcher@master", "delay_node@master was started again"), "the restart")
    arm(rig)
    assert forward(rig)["queue_depth"] < 100
    record(
        "a flood into a link that stands still and holds, `link set` in the middle, an emergency stop, kill -9"
        f"{rig.way}",
        f"{depth} waited at a limit of 100, {dropped} dropped and counted; the tip stopped {stopped_ms:.0f} ms after "
        "the command; set and cleared at once; what it held went with the killed process, armed and going on",
    )

"""The hand that a live experiment holds: a stall loses it, and a page that has it keeps it."""

from pathlib import Path

import pytest
from experiment_bench import plan_of
from telenano_lab.experiments.apparatus import live
from telenano_lab.experiments.apparatus.live import Live
from telenano_lab.experiments.desk import Desk

from telenano.console import holding
from telenano.console.lease import EXPERIMENT, VANISHED_NS, Party, current, take
from telenano.console.lease_register import LeaseRegister
from telenano.wire import RefusedError


def test_the_hand_that_a_stall_has_lost_is_taken_again_and_one_that_a_page_has_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(live, "send_control", lambda *arguments: {})
    plan, told, register = plan_of(tmp_path), list[str](), LeaseRegister()
    rig = Live(plan, tmp_path, Desk(plan), told.append)
    rig._lease = rig._hold.enter_context(holding(EXPERIMENT))
    rig._command("stop", "haptic_node@master")
    assert (told, rig._was_lost) == ([], False)
    # nothing was heard of it for two seconds
    register.change(lambda lease, now_ns: current(lease, now_ns + 2 * VANISHED_NS))
    assert register.look().holder is None
    rig._command("stop", "haptic_node@master")
    holder = register.look().holder
    assert holder is not None and holder.what == EXPERIMENT and rig._was_lost
    assert told == ["the experiment stood still for a second and lost the hand: it has taken it again"]
    page = Party("page", "Tina", "teacher")
    register.change(lambda lease, now_ns: take(lease, page, now_ns))
    with pytest.raises(RefusedError, match="Tina holds control"):
        rig._command("stop", "haptic_node@master")
    rig.close()
    assert register.look().is_held_by(page)

"""The hand that a live experiment holds: a stall loses it, and a page that has it keeps it."""

from pathlib import Path

import pytest
from experiment_bench import plan_of
from telenano_lab.experiments.apparatus import live
from telenano_lab.experiments.apparatus.live import Live
from telenano_lab.experiments.desk import Desk

from telenano.console import holding
from telenano.testing import LeaseOfRig
from telenano.wire import RefusedError


def test_the_hand_that_a_stall_has_lost_is_taken_again_and_one_that_a_page_has_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(live, "send_control", lambda *arguments: {})
    plan, told, lease = plan_of(tmp_path), list[str](), LeaseOfRig()
    rig = Live(plan, tmp_path, Desk(plan), told.append)
    rig._lease = rig._hold.enter_context(holding("experiment"))
    rig._command("stop", "haptic_node@master")
    assert (told, rig._was_lost) == ([], False)
    lease.lapse()
    assert lease.holder() == ""
    rig._command("stop", "haptic_node@master")
    assert lease.holder() == "experiment" and rig._was_lost
    assert told == ["the experiment stood still for a second and lost the hand: it has taken it again"]
    lease.take_for_page("Tina")
    with pytest.raises(RefusedError, match="Tina holds control"):
        rig._command("stop", "haptic_node@master")
    rig.close()
    assert lease.holder() == "Tina"

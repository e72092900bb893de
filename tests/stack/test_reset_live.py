"""A stop in contact on a live rig: arming moves neither tip nor hand, and `arm --return` is a word of its own."""

from pathlib import Path

import pytest
from stack_rig import Rig

from telenano.recording.reader import Recording

pytestmark = [pytest.mark.check, pytest.mark.drawn(0.0, "telenano/afm/", "telenano/hand/", "services/")]
# A simulated hand that nobody touches, in the field of a tip that is away [m].
STILL_M = 5e-5


def test_a_stop_in_contact_then_arm_then_the_way_back(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "300", scenario="fig12")
        rig.wait_until(rig.running, "a running session")
        rig.wait_until(lambda: rig.newest("afm/state").in_contact, "contact")
        # The hand rests where it is.
        assert rig.telenano("session", "stop", "--target", "haptic_node").returncode == 0
        assert rig.telenano("estop").returncode == 0
        rig.wait_until(lambda: -rig.newest("afm/state").base_position_m[2] <= -99e-9, "a tip that is away")
        before = rig.newest("afm/state"), rig.newest("haptic/state")
        armed = rig.telenano("session", "arm")
        assert armed.returncode == 0, armed.stderr
        assert "its base stays at -100 nm" in armed.stdout
        assert "`telenano session arm --return` takes it back to 0 nm at 50 nm/s, for 2 s" in armed.stdout
        rig.wait_until(lambda: rig.newest("afm/state").mode == "follow", "a tip that follows")
        after = rig.newest("afm/state"), rig.newest("haptic/state")
        assert after[0].base_position_m[2] == pytest.approx(before[0].base_position_m[2], rel=0.0, abs=1e-12)
        back = rig.telenano("session", "arm", "--return", "speed_m_per_s=1e-7")
        assert back.returncode == 0, back.stderr
        lines = back.stdout.splitlines()
        assert lines[0].startswith("the base of the tip goes from -100 nm to 0 nm at 100 nm/s, for 1 s; any key")
        assert lines[-1] == "the tip is back: its base is at 0 nm"
        done = rig.telenano("session", "arm", "--return")
        assert (done.returncode, done.stdout) == (0, "the tip is where the hand has it: there is no way back\n")
        code, _, err = rig.stop()
        assert code == 0, err + rig.logs()
    finally:
        rig.close()
    (path,) = rig.out.glob("*.mcap")
    recording = Recording(path)
    tips = [message.decode() for message in recording.messages(["afm/state"])]
    hands = [message.decode() for message in recording.messages(["haptic/state"])]
    # From the arming until the word: the first state that follows again, and the first that goes.
    stopped = max(number for number, tip in enumerate(tips) if tip.mode == "estop")
    stays = [tip for tip in tips[stopped + 1 :] if -tip.base_position_m[2] < -99.9e-9]
    assert len(stays) > 1
    begun_ns, ended_ns = stays[0].t_ns, stays[-1].t_ns
    places = [-hand.position_m[2] for hand in hands if begun_ns <= hand.t_ns <= ended_ns]
    assert max(places) - min(places) <= STILL_M
    # On the way the base keeps to its speed, and comes from no further than it was told.
    way = [tip for tip in tips if tip.t_ns > ended_ns]
    assert max(-tip.base_position_m[2] for tip in way) <= 0.1e-9 + 1.5e-6 * STILL_M
    assert not any(tip.in_contact for tip in tips[stopped + 1 :])

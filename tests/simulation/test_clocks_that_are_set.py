"""Sites that begin again with a clock that was set: the joined recording has each message at its true time."""

import random
from pathlib import Path

import faulty_rig
import msgpack
import numpy as np
import pytest
from campaign import report
from fault_schedule import Event, Schedule

from telenano.recording.reader import Recording
from telenano.recording.site_clock import Timeline, is_of_slave

# A message is at a wrong time beyond this [s]; its way takes 5 ms.
WRONG_S = 0.02


def drawn(seed: int) -> Schedule:
    dice = random.Random(f"set clocks {seed}")
    begins: Event = {"at_s": 0.0, "kind": "clock", "ahead_s": dice.choice([0.0, 0.2, -7.0]), "drift_ppm": 0}
    events = [begins]
    for at_s in sorted(dice.sample([1.2, 2.5, 4.0, 5.5], dice.choice([1, 2, 3]))):
        by_s = dice.choice([-1.0, 1.0]) * 10.0 ** dice.uniform(-1.0, 4.0)
        events.append({"at_s": at_s, "kind": "site_restart", "ahead_s": round(by_s, 3)})
    return Schedule(seed, "wave", 0.005, 0.0, tuple(events), 50.0)


@pytest.mark.check("takes 2 s each")
@pytest.mark.parametrize("seed", range(5))
def test_a_joined_recording_has_each_message_at_the_time_at_which_it_was_sent(tmp_path: Path, seed: int) -> None:
    folder = tmp_path / "session"
    faulty_rig.run(drawn(seed), folder)
    report(folder)
    true_ns = {}
    for src, topic, seq, stamp_ns, sent_ns, _ in msgpack.unpackb((folder / "ledger.msgpack").read_bytes()):
        true_ns[src, topic, seq, stamp_ns] = sent_ns
    both = Recording(folder / "both.mcap")
    timeline, off_s, beyond_s = Timeline(both), [], []
    epoch_ns = faulty_rig.EPOCH_OFFSET_NS + faulty_rig.BEGIN_NS
    for message in both.messages():
        key = (message.src, message.topic, message.seq, message.publish_ns)
        if is_of_slave(message.src) and message.channel.via == "direct" and key in true_ns:
            off_s.append((timeline.time_ns(message) - epoch_ns - true_ns[key]) * 1e-9)
            beyond_s.append((message.log_ns - epoch_ns - true_ns[key]) * 1e-9)
    assert len(off_s) > 500
    assert (np.abs(off_s) > WRONG_S).mean() < 0.01, timeline.clock
    # A recorder receives what was sent on its machine within a fraction of a second.
    assert ((np.array(beyond_s) < -WRONG_S) | (np.array(beyond_s) > 0.5)).mean() < 0.01, timeline.clock

from collections.abc import Callable
from pathlib import Path

import zmq
from mcap.writer import Writer
from processor_time import ratio_of_costs
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state

from services.recorder.intake import Intake, Listener
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.bus import Subscriber
from telenano.testing import VirtualClock
from telenano.wire import encode

MESSAGES = 8000


def test_recording_keeps_up_and_costs_a_small_multiple_of_a_plain_writer(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    payloads = [encode(haptic_state(seq)) for seq in range(MESSAGES)]

    def plain() -> None:
        with (tmp_path / "plain.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start()
            channel = writer.register_channel("haptic/state", "msgpack", 0)
            for seq, payload in enumerate(payloads):
                writer.add_message(channel, EPOCH_NS + seq, payload, EPOCH_NS + seq, seq)
            writer.finish()

    def ours() -> None:
        intake = Intake(RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path)))
        for seq, payload in enumerate(payloads):
            intake.record(listener, [b"haptic/state", payload], EPOCH_NS + seq * MILLISECOND_NS)
            if seq % 200 == 199:
                intake.flush()
        intake.finish()

    with zmq.Context() as context:
        listener = Listener(
            "haptic_node@master", Subscriber(context, VirtualClock(), {"inproc://nowhere": ["haptic/state"]})
        )
        # about 0.8 when measured; a flush every 200 messages and the reading of each header are in it
        ratio = ratio_of_costs(ours, plain, below=2.0)
        listener.subscriber.close()
    record_property("ratio_to_plain_writer", ratio)
    assert ratio < 2.0

    recording = Recording(tmp_path / "session.mcap")
    fields = ["position_m.2", "operator_force_n.2", "t_ns", "log_ns"]
    found = {}
    # about 1.3 when measured
    ratio = ratio_of_costs(
        lambda: found.update(recording.columns("haptic/state", fields)),
        lambda: [message.fields() for message in recording.messages(["haptic/state"])],
        below=5.0,
    )
    assert len(found["t_ns"]) == MESSAGES
    record_property("ratio_of_columns_to_decoding", ratio)
    assert ratio < 5.0

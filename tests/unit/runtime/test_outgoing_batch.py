"""Copies for a recorder: when they go out, in which order, and that nothing of them is left behind."""

from proto.batch import Batch, SentCopy, read_batch
from services.runtime.bus.outgoing_batch import DUE_NS, LATEST_NS, OutgoingBatch
from telenano.extend.testing import VirtualClock

NEVER_NS = 2**62


class Outgoing:
    def __init__(self) -> None:
        self.clock = VirtualClock(start_ns=1_000)
        self.sent: list[Batch] = []
        self.batch = OutgoingBatch(self.clock.monotonic_ns, lambda payload: self.sent.append(read_batch(payload)))


def test_it_is_due_by_its_oldest_copy_and_never_while_empty() -> None:
    rig = Outgoing()
    assert (rig.batch.due_ns, rig.batch.latest_ns) == (NEVER_NS, NEVER_NS)
    rig.batch.add(b"a", b"1")
    rig.clock.advance_ns(700)
    rig.batch.add(b"b", b"2")
    assert (rig.batch.due_ns, rig.batch.latest_ns) == (1_000 + DUE_NS, 1_000 + LATEST_NS)
    rig.batch.flush()
    assert rig.sent == [Batch(1, [SentCopy(1_000, b"a", b"1"), SentCopy(1_700, b"b", b"2")], False)]
    assert (rig.batch.due_ns, rig.batch.latest_ns) == (NEVER_NS, NEVER_NS)
    rig.batch.flush()
    assert len(rig.sent) == 1


def test_large_messages_go_out_before_the_next_one_and_the_end_is_said() -> None:
    rig = Outgoing()
    rig.batch.add(b"a", bytes(65_535))
    rig.batch.add(b"a", b"1")
    assert not rig.sent
    rig.batch.add(b"b", b"2")
    assert [len(copy.payload) for copy in rig.sent[0].sent] == [65_535, 1]
    rig.batch.flush(last=True)
    rig.batch.flush(last=True)
    assert [(len(batch.sent), batch.last) for batch in rig.sent] == [(2, False), (1, True), (0, True)]


def test_what_a_process_that_stood_still_has_kept_goes_out_before_what_it_sends_next() -> None:
    rig = Outgoing()
    rig.batch.add(b"a", b"before")
    rig.clock.advance_ns(2_000_000_000)
    rig.batch.add(b"a", b"after")
    assert [[copy.payload for copy in batch.sent] for batch in rig.sent] == [[b"before"]]
    rig.batch.flush()
    assert [copy.payload for copy in rig.sent[1].sent] == [b"after"]

"""The state of a node in its journal: of any size, in messages of their own, or refused with an event."""

from typing import Any, NamedTuple

import msgspec
import pytest
from test_runtime_node import MS, Journalled, Rig, journalled_rig

from services.afm_node.node import AfmNode
from services.haptic_node.node import HapticNode
from telenano.afm.sim import simulated_afm
from telenano.hand.sim import SimulatedHaptic
from telenano.runtime.loop import journal
from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import HapticConfig
from telenano.wire import encode
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.messages import SessionEvent
from telenano.wire.node_state import is_whole, pack


class State(NamedTuple):
    """Whatever a test keeps."""

    data: Any


def states_of(rig: Rig) -> list[bytes]:
    """Return the state of each batch, put together."""
    states: list[bytes] = []
    for message in rig.bus.of(NodeJournal):
        assert len(encode(message)) < 2**20
        if message.kind.data:
            states.append(message.state.data)
            first_turn = message.first_turn
        else:
            # the rest follows its batch, and says which one that is
            assert message.first_turn == first_turn
            assert (message.inputs, message.outputs) == ((), {})
            states[-1] += message.state.data
    return states


def rig_with(monkeypatch: pytest.MonkeyPatch, data: Any) -> Rig:
    monkeypatch.setattr(Journalled, "capture", lambda node: State(data))
    return journalled_rig(period_ns=10 * MS)


@pytest.mark.parametrize("size_bytes", [100, 2**19 - 100, 2**19, 2**19 + 1, 5_000_000])
def test_a_state_of_any_size_is_kept(monkeypatch: pytest.MonkeyPatch, size_bytes: int) -> None:
    data = bytes(range(256)) * (size_bytes // 256 + 1)
    rig = rig_with(monkeypatch, data[:size_bytes])
    rig.run_until(700 * MS)
    (state,) = states_of(rig)
    assert is_whole(state)
    assert msgspec.msgpack.decode(state)[2][0] == data[:size_bytes]
    assert rig.bus.of(SessionEvent) == []


def test_a_large_state_is_captured_less_often(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = rig_with(monkeypatch, bytes(3 * 2**20))
    rig.run_until(10_000 * MS)
    kept = [bool(state) for state in states_of(rig)]
    assert all(is_whole(state) for state in states_of(rig) if state)
    assert len(kept) > 15
    # 3 MiB at a mebibyte a second, and at the half seconds
    assert sum(kept) in (3, 4)
    small = rig_with(monkeypatch, bytes(2**19 - 100))
    small.run_until(10_000 * MS)
    assert all(states_of(small))


def test_the_messages_of_a_state_are_sent_one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_STATE_PIECE", 1000)
    rig = rig_with(monkeypatch, bytes(2500))
    kept = rig.loop._journal
    assert kept is not None
    rig.run_until(30 * MS)
    kept.complete()
    sent = []
    while True:
        more = kept.publish()
        sent.append(len(rig.bus.of(NodeJournal)))
        if not more:
            break
    assert sent == [1, 2, 3]
    assert not kept.publish()


def test_a_batch_is_complete_with_4096_turns() -> None:
    rig = journalled_rig(period_ns=10 * MS)
    kept = rig.loop._journal
    assert kept is not None
    for _ in range(4095):
        kept.record_turn(journal.DEADLINE)
    assert not kept.full
    kept.record_turn(journal.DEADLINE)
    assert kept.full


@pytest.mark.parametrize("value", [object(), 2**80, ValueError("a message waits"), AttributeError("no 'state'")])
def test_a_state_that_cannot_be_kept_is_an_event_once(monkeypatch: pytest.MonkeyPatch, value: Any) -> None:
    def capture(node: Journalled) -> State:
        if isinstance(value, Exception):
            raise value
        return State(value)

    monkeypatch.setattr(Journalled, "capture", capture)
    rig = journalled_rig(period_ns=10 * MS)
    rig.run_until(2500 * MS)
    assert len(rig.bus.of(NodeJournal)) > 3
    assert set(states_of(rig)) == {b""}
    (event,) = rig.bus.of(SessionEvent)
    assert (event.level, event.kind) == ("warning", "node")
    assert event.text.startswith("the state of this node was not recorded, so that no re-run can begin here: ")


def test_a_node_with_a_real_device_keeps_no_state(bench_of: Any) -> None:
    hand, instrument = HapticConfig(), AfmConfig()
    handle = SimulatedHaptic(hand.to_plant_params(), hand.device.start_position_m)
    nodes: list[Any] = [
        HapticNode(bench_of("haptic_node@master").context, hand.model_copy(update={"driver": "serial"}), handle),
        AfmNode(
            bench_of("afm_node@slave").context,
            instrument.model_copy(update={"driver": "modbus"}),
            simulated_afm(instrument.to_params()),
        ),
    ]
    for node in nodes:
        assert pack(node) == b""

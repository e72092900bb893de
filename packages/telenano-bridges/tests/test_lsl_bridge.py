"""What an inlet of the Lab Streaming Layer receives from the bridge, and what is said of the time of it."""

import json
import time
from collections.abc import Callable
from typing import Any

import pytest
from telenano_bridges import lsl as lsl_bridge
from telenano_bridges.lsl import Comparison, LslBridge, Sample, Stream, check_library, compare_clocks, lsl_streams

from telenano.recording import RecordedMessage, recorded
from telenano.wire import ConfigError, Message, example

SECOND_NS = 10**9
EPOCH_NS = 1_750_000_000_000_000_000
RECEIVED_NS = EPOCH_NS + 3_000_000
WAIT_S = 20.0
HAND = "haptic/state"


def hand_state(**fields: Any) -> Message:
    return example(HAND, src="haptic_node@master", seq=3, t_ns=EPOCH_NS + 3_000_000, **fields)


def event(seq: int = 1) -> Message:
    return example("session/event", src="afm_node@slave", seq=seq, t_ns=EPOCH_NS + 1_000_000)


def journal_of(src: str, offset_ns: int) -> RecordedMessage:
    return recorded("node/journal", example("node/journal", src=src, epoch_offset_ns=offset_ns), RECEIVED_NS)


class Kept:
    """Keeps what is opened and sent."""

    def __init__(self) -> None:
        self.streams: list[Stream] = []
        self.samples: dict[str, list[Sample]] = {}

    def __call__(self, stream: Stream) -> Callable[[Sample], None]:
        self.streams.append(stream)
        return self.samples.setdefault(stream.name, []).append


def bridge(kept: Kept, **given: Any) -> LslBridge:
    return LslBridge(kept, lambda: 7.25, 0, monotonic_ns=lambda: 7 * SECOND_NS, **given)


def test_a_state_has_the_time_of_its_sending_on_the_clock_of_lsl() -> None:
    kept, hand = Kept(), hand_state()
    bridge(kept).run([journal_of(hand.src, EPOCH_NS), recorded(HAND, hand, RECEIVED_NS)])
    _, stream = kept.streams
    assert [label for label, _ in stream.channels][:4] == [
        "position_m.x",
        "position_m.y",
        "position_m.z",
        "velocity_m_per_s.x",
    ]
    assert dict(stream.channels)["operator_force_n.z"] == "N" and dict(stream.channels)["session_s"] == "s"
    (found,) = kept.samples["telenano haptic/state"]
    assert found.values[:3] == hand.position_m and found.values[-1] == hand.session_s
    # the offset between the clocks is 7.25 s - 7 s
    assert found.time_s == pytest.approx((hand.t_ns - EPOCH_NS) * 1e-9 + 0.25, abs=1e-12)
    assert stream.facts["clock_offset_s"] == "0.250000000" and stream.facts["clock_uncertainty_s"] == "0.000000000"


def test_the_stream_of_the_markers_is_open_before_there_is_one() -> None:
    kept = Kept()
    found = bridge(kept)
    assert [stream.name for stream in kept.streams] == ["telenano markers"]
    found.run([recorded("session/event", event(), 5 * SECOND_NS)])
    assert len(kept.streams) == 1 and len(kept.samples["telenano markers"]) == 1


def test_a_node_whose_clock_is_not_known_is_not_published() -> None:
    kept, tip = Kept(), example("afm/state", t_ns=RECEIVED_NS)
    remote = bridge(kept, is_here=lambda node: not node.endswith("@slave"))
    state = recorded("afm/state", tip, RECEIVED_NS)
    remote.run([state, journal_of(tip.src, EPOCH_NS), state])
    assert len(kept.streams) == 1 and remote.elsewhere == {tip.src} and remote.sent == 0
    near = bridge(kept)
    near.run([state])
    assert near.sent == 0
    near.run([journal_of(tip.src, EPOCH_NS), state])
    assert near.sent == 1


def test_an_event_is_a_marker_and_says_which_time_it_has() -> None:
    kept, told = Kept(), event()
    bridge(kept).run([
        recorded("session/event", told, 5 * SECOND_NS),
        journal_of(told.src, EPOCH_NS),
        recorded("session/event", told, 5 * SECOND_NS),
        recorded("session/event", told, RECEIVED_NS, site="master"),
    ])  # fmt: skip
    first, second = (json.loads(found.values[0]) for found in kept.samples["telenano markers"])
    assert (first["stamped"], second["stamped"]) == ("received", "sent")
    assert first["topic"] == "session/event" and first["text"] == told.text
    times = [found.time_s for found in kept.samples["telenano markers"]]
    assert times == pytest.approx([5.25, (told.t_ns - EPOCH_NS) * 1e-9 + 0.25], abs=1e-12)


def test_what_cannot_be_read_is_left_out() -> None:
    kept, hand = Kept(), hand_state()
    whole = recorded(HAND, hand, RECEIVED_NS)
    found = bridge(kept)
    found.run([journal_of(hand.src, 0), whole._replace(payload=b"\xc1"), whole._replace(payload=b"\x80"), whole])
    assert found.sent == 1


def test_the_narrowest_reading_bounds_the_error_of_the_clock() -> None:
    now = {"ns": 0}
    widths = iter([900, 40, 300] * 2)

    def monotonic_ns() -> int:
        return now["ns"]

    def lsl_clock() -> float:
        # it is read in the first tenth of what the reading takes, and is 3 s ahead
        width = next(widths)
        at = now["ns"] + width // 10
        now["ns"] += width
        return at * 1e-9 + 3.0

    found = compare_clocks(lsl_clock, monotonic_ns, readings=3)
    assert found.uncertainty_s == pytest.approx(20e-9)
    assert abs(found.offset_s - 3.0) <= found.uncertainty_s


def test_the_clocks_are_compared_again_while_it_runs() -> None:
    now, ahead = {"ns": 0}, {"s": 1.0}
    kept, hand = Kept(), hand_state()
    clocks = LslBridge(kept, lambda: now["ns"] * 1e-9 + ahead["s"], 0, monotonic_ns=lambda: now["ns"])
    assert clocks.clocks == Comparison(1.0, 0.0)
    now["ns"], ahead["s"] = 11 * SECOND_NS, 1.5
    clocks.run([journal_of(hand.src, 0), recorded(HAND, hand, RECEIVED_NS)])
    assert clocks.clocks.offset_s == pytest.approx(1.5)


def test_without_the_package_the_command_says_what_adds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(lsl_bridge.importlib, "import_module", missing)
    with pytest.raises(ConfigError, match="needs pylsl: pip install pylsl"):
        lsl_streams()

    def without_library(name: str) -> Any:
        raise RuntimeError("LSL binary library file was not found. Please\n many lines")

    monkeypatch.setattr(lsl_bridge.importlib, "import_module", without_library)
    with pytest.raises(ConfigError, match=r"does not find the library liblsl .*PYLSL_LIB"):
        lsl_streams()
    (finding,) = check_library()
    assert finding.level == "warning" and "PYLSL_LIB" in finding.found


# The threads of liblsl outlive its streams, and it speaks to the network.
@pytest.mark.endurance
def test_an_inlet_reads_the_stream_back_with_its_times_and_their_error() -> None:
    try:
        opens, clock = lsl_streams()
    except ConfigError as error:
        pytest.skip(str(error))
    import pylsl

    hand = hand_state()
    offset_ns = hand.t_ns - time.monotonic_ns()
    name = f"telenano test {time.monotonic_ns()}"
    sender = LslBridge(opens, clock, 0, name)
    sender.run([journal_of(hand.src, offset_ns), recorded(HAND, hand, RECEIVED_NS)])
    sender.run([recorded("session/event", event(), time.monotonic_ns())])
    states = pylsl.resolve_byprop("name", f"{name} haptic/state", timeout=WAIT_S)
    markers = pylsl.resolve_byprop("name", f"{name} markers", timeout=WAIT_S)
    assert len(states) == len(markers) == 1, "the streams were not found: is multicast on the loopback allowed?"
    inlet, marks = pylsl.StreamInlet(states[0]), pylsl.StreamInlet(markers[0])
    about = inlet.info(WAIT_S).desc().child("synchronization")
    uncertainty_s = float(about.child_value("clock_uncertainty_s"))
    assert 0.0 < uncertainty_s < 1.0
    inlet.open_stream(WAIT_S)
    marks.open_stream(WAIT_S)
    end_s, received, told = time.monotonic() + WAIT_S, None, None
    while (received is None or told is None) and time.monotonic() < end_s:
        sender.run([
            recorded(HAND, hand, RECEIVED_NS),
            recorded("session/event", event(), time.monotonic_ns()),
        ])  # fmt: skip
        values, time_s = inlet.pull_sample(timeout=0.1)
        received = received or (values and (values, time_s))
        told = told or marks.pull_sample(timeout=0.1)[0]
    assert received and told
    values, time_s = received
    assert tuple(values[:3]) == hand.position_m
    # sent at the time that the node's clock said, which LSL's clock has to agree with
    assert time_s == pytest.approx((hand.t_ns - offset_ns) * 1e-9 + sender.clocks.offset_s, abs=1e-6)
    assert json.loads(told[0])["topic"] == "session/event"

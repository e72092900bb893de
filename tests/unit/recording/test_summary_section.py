"""The summary of a closed recording by its index is that of its messages, or there is none."""

import subprocess
import sys
from pathlib import Path

import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state

from telenano.recording import summary_section
from telenano.recording.mcap_scan import scan
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import GapRecord
from telenano.recording.rewrite import filter_recording
from telenano.recording.summary_section import quick_info
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode

SRC = "haptic_node@master"


def written(
    folder: Path, numbers: list[int], *, gap: bool = False, note: str = "", finish: bool = True, each: int = 100
) -> Path:
    """Write haptic/state with these numbers, a chunk for each hundred or another number."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder))
    writer.attach("site.yaml", "application/yaml", b"nodes: {}\n", EPOCH_NS)
    writer.add_metadata("recording", {"node": NODE})
    channel = writer.channel("haptic/state", SRC, "master")
    for place, seq in enumerate(numbers):
        log_ns = EPOCH_NS + place * MILLISECOND_NS
        writer.write(channel, log_ns, log_ns, seq, encode(haptic_state(seq)))
        if place % each == each - 1:
            writer.flush()
    if gap:
        record = GapRecord(channel_topic="haptic/state", src=SRC, first_missing=200, last_missing=209, count=10)
        writer.write_gap(log_ns, record)
    if finish:
        writer.finish({"state": "stopped", "note": note})
    else:
        # as by a kill
        writer.flush()
        writer.abandon()
    return writer.path


def test_it_is_the_summary_of_the_messages(tmp_path: Path) -> None:
    path = written(tmp_path, list(range(450)))
    found, expected = quick_info(path), Recording(path).info()
    assert found is not None
    assert (found.basis, expected.basis) == ("summary", "messages")
    assert found.complete and expected.complete
    unknown = {"basis": "summary", "recorder_lag": None, "channels": ()}
    assert found.model_copy(update=unknown) == expected.model_copy(update=unknown)
    unread = {"size_bytes": None, "repeated": None, "restarts": None}
    assert found.channels == tuple(channel.model_copy(update=unread) for channel in expected.channels)


def test_what_the_recorder_knows_to_be_missing_is_in_it(tmp_path: Path) -> None:
    path = written(tmp_path, [*range(200), *range(210, 400)], gap=True, note="the drain took too long")
    found, expected = quick_info(path), Recording(path).info()
    assert found is not None
    assert not found.complete
    assert (found.lost, found.missing) == (10, expected.missing)
    states = next(channel for channel in found.channels if channel.topic == "haptic/state")
    assert (states.lost, states.gaps) == (10, 1)


@pytest.mark.parametrize(
    "numbers",
    [[*range(200), *range(210, 400)], [*range(300), *range(100), *range(110, 200)]],
    ids=["a gap that is not recorded", "a gap after a restart"],
)
def test_where_the_numbers_do_not_agree_the_messages_have_to_be_read(tmp_path: Path, numbers: list[int]) -> None:
    assert quick_info(written(tmp_path, numbers)) is None


@pytest.mark.parametrize("at", [(1200,), (1234,), (1, 1999), (700, 750, 755, 1800)])
def test_where_a_process_was_started_again_few_chunks_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: tuple[int, ...]
) -> None:
    ends = zip((0, *at), (*at, 2000), strict=True)
    path = written(tmp_path, [seq for first, end in ends for seq in range(end - first)], each=10)
    unpacked = set()
    inside = summary_section.unpack
    monkeypatch.setattr(summary_section, "unpack", lambda *given: unpacked.add(given[1].offset) or inside(*given))
    found = quick_info(path)
    expected = Recording(path).info()
    assert found is not None
    assert (found.complete, found.missing, found.lost) == (expected.complete, expected.missing, expected.lost)
    states = [next(row for row in each.channels if row.topic == "haptic/state") for each in (found, expected)]
    assert [(row.restarts, row.messages, row.rate_hz) for row in states] == 2 * [
        (len(at), states[0].messages, states[0].rate_hz)
    ]
    # Two hundred chunks are halved eight times, and of each half two are looked at.
    assert len(unpacked) <= 2 + 16 * len(at)


def test_a_copy_that_lacks_a_part_has_to_be_read(tmp_path: Path) -> None:
    path = written(tmp_path, list(range(450)))
    damaged = bytearray(path.read_bytes())
    blocks = scan(bytes(damaged)).blocks
    damaged[blocks[len(blocks) // 2].data_start + 50] ^= 0xFF
    path.write_bytes(damaged)
    assert not Recording(path).info().complete
    filter_recording(path, tmp_path / "recovered.mcap")
    assert quick_info(tmp_path / "recovered.mcap") is None


def test_a_file_that_was_not_closed_has_no_summary(tmp_path: Path) -> None:
    assert quick_info(written(tmp_path, list(range(450)), finish=False)) is None


@pytest.mark.check("takes 3 s")
def test_no_damage_to_the_summary_ends_in_anything_but_the_other_way(tmp_path: Path) -> None:
    path = written(tmp_path, list(range(450)))
    whole = path.read_bytes()
    for place in range(len(whole) - 1500, len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        assert quick_info(path) is None
    for length in (0, 8, 40, len(whole) - 1):
        path.write_bytes(whole[:length])
        assert quick_info(path) is None


def test_a_summary_of_any_length_unpacks_the_chunks_at_both_ends_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unpacked = []
    inside = summary_section.unpack
    monkeypatch.setattr(summary_section, "unpack", lambda *given: unpacked.append(given[1].offset) or inside(*given))
    for messages in (300, 1500):
        unpacked.clear()
        path = written(tmp_path / str(messages), list(range(messages)))
        assert quick_info(path) is not None
        assert len(scan(path.read_bytes()).blocks) >= messages // 100
        assert len(unpacked) == 2


def test_a_long_recording_in_which_nobody_acted_is_shown_without_what_only_messages_need(tmp_path: Path) -> None:
    path = written(tmp_path, list(range(450)))
    code = f"""
import atexit, sys
from telenano.cli.app import main
import telenano.cli.commands.bag as bag
bag._LONG_BYTES = 0
needless = {{"numpy", "zmq", "msgspec", "matplotlib", "pyarrow"}}
needless |= {{"telenano.wire.messages", "telenano.wire.codec", "telenano.recording.reader"}}
atexit.register(lambda: print("needless:", sorted(needless & set(sys.modules))))
sys.argv = ["telenano", "bag", "info", {str(path)!r}, "--json"]
main()
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert '"basis": "summary"' in found
    assert found.endswith("needless: []\n")

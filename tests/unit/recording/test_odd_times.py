"""Messages that are dated far from all others, and an index that repeats itself, are named and cost nothing."""

from pathlib import Path

import pytest
from forged_files import copied, repeated_index
from made_sessions import BEGAN_NS, Made

from telenano.recording.odd_times import LONGEST_PAUSE_NS, Dates
from telenano.recording.reader import Recording
from telenano.recording.summary_section import quick_info
from telenano.recording.verify import verify


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("odd")
    return copied(Made().write(folder), folder / "chunks.mcap")


def test_a_pause_of_a_day_parts_the_dates_and_the_most_of_them_count() -> None:
    dates = Dates()
    for at_ns in (0, 5, 10 * LONGEST_PAUSE_NS, 10 * LONGEST_PAUSE_NS + 7, 11 * LONGEST_PAUSE_NS + 7):
        dates.add(at_ns, at_ns, 1)
    assert [tuple(group) for group in dates.groups()] == [
        (0, 5, 2),
        (10 * LONGEST_PAUSE_NS, 11 * LONGEST_PAUSE_NS + 7, 3),
    ]
    assert dates.most() == (10 * LONGEST_PAUSE_NS, 11 * LONGEST_PAUSE_NS + 7)
    assert Dates().most() == (0, 0)
    # Most of it is dated to a time that no clock shows.
    dates.add(2**63, 2**63 + 1, 100)
    assert dates.most() == (10 * LONGEST_PAUSE_NS, 11 * LONGEST_PAUSE_NS + 7)


@pytest.mark.grid(closed=True)
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize(
    ("place", "log_ns", "words"),
    [
        (0, 0, "1 message is dated 1970-01-01 00:00:00 UTC, 20255 days before the others ("),
        (3000, 3, "1 message is dated 1970-01-01 00:00:00 UTC, 20255 days before the others ("),
        (5000, 2**64 - 1, "1 message is dated 2554-07-21 23:34:33 UTC, 193249 days after the others ("),
    ],
)
def test_a_message_of_another_time_is_named_and_moves_neither_start_nor_end(
    made: Path, tmp_path: Path, place: int, log_ns: int, words: str, closed: bool
) -> None:
    path = copied(made, tmp_path / "odd.mcap", lambda at, ns: log_ns if at == place else ns, closed=closed)
    begin_ns, end_ns = Recording(made).span_ns
    recording = Recording(path)
    assert recording.span_ns[0] - begin_ns < 10**9
    assert recording.span_ns[1] == end_ns
    (text,) = recording.odd
    assert text.startswith(words)
    info = Recording(path).info()
    assert (info.odd, (info.start_ns, info.end_ns)) == ((text,), recording.span_ns)
    assert quick_info(path) is None
    verdict = verify([path])
    assert [finding.text for finding in verdict.findings if finding.check == "odd"] == [text]
    assert not verdict.sound


def test_a_recording_of_days_without_a_pause_is_not_odd(made: Path, tmp_path: Path) -> None:
    step_ns = LONGEST_PAUSE_NS // 100
    path = copied(made, tmp_path / "days.mcap", lambda place, ns: BEGAN_NS + place * step_ns)
    assert Recording(path).span_ns[1] - BEGAN_NS > 30 * LONGEST_PAUSE_NS
    assert Recording(path).odd == () == Recording(made).odd


@pytest.mark.parametrize("what", ["chunks", "attachments", "metadata"])
def test_what_an_index_names_again_is_read_once(
    made: Path, tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "repeated.mcap"
    path.write_bytes(repeated_index(made.read_bytes(), what, 30))
    assert quick_info(made) is not None
    assert quick_info(path) is None
    unpacked: list[int] = []
    inside = Recording._content
    monkeypatch.setattr(Recording, "_content", lambda *given: unpacked.append(given[2].offset) or inside(*given))
    found, sound = Recording(path), Recording(made)
    read = list(found.select())
    assert len(unpacked) <= 3 * len(sound._layout.blocks)
    assert read == list(sound.select())
    assert found.attachments == sound.attachments
    if what == "chunks":
        text = f"the index names chunks again, {29 * len(found._layout.blocks)} times: each is read once"
        assert found.odd == (text,)
        assert [finding.text for finding in verify([path]).findings if finding.check == "odd"] == [text]

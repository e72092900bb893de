"""A time of a recording in each form in which an output prints one, read in one way by all commands that take times."""

import json
import os
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from telenano.recording.reader import Recording
from telenano.recording.recorded_time import recorded_time
from telenano.testing import run
from telenano.wire.errors import ConfigError

FIRST_NS = round(datetime(2026, 1, 31, 23, 59, 30, tzinfo=UTC).timestamp()) * 10**9 + 123_456_789


@pytest.fixture(autouse=True)
def in_kolkata(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Times of day are those of this machine, which is half an hour off the whole ones."""
    with monkeypatch.context() as patched:
        patched.setitem(os.environ, "TZ", "Asia/Kolkata")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.parametrize(
    ("text", "after_ns"),
    [
        ("2.5", 2_500_000_000),
        ("0.000000001", 1),
        (" 2.5 s", 2_500_000_000),
        ("250 ms", 250_000_000),
        ("1:02.5", 62_500_000_000),
        ("2 min", 120 * 10**9),
        (str(FIRST_NS + 7), 7),
        (f"{FIRST_NS + 7} ns", 7),
        (f"{FIRST_NS // 10**9}.123456790", 1),
        ("05:29:31", 876_543_211),
        ("05:30:01.5", 31_376_543_211),
        ("2026-01-31T23:59:31Z", 876_543_211),
        ("2026-02-01 05:29:31", 876_543_211),
        ("2026-01-31T23:59:31.000001+00:00", 876_544_211),
    ],
)
def test_each_form_is_the_time_that_it_says(text: str, after_ns: int) -> None:
    assert recorded_time(text).at(FIRST_NS) - FIRST_NS == after_ns


def test_a_time_of_day_may_be_that_of_the_next_day() -> None:
    evening_ns = FIRST_NS - (5 * 3600 + 30 * 60) * 10**9
    assert recorded_time("00:00:30").at(evening_ns) - evening_ns == 59_876_543_211


@pytest.mark.parametrize("text", ["", "soon", "-1", "1:2", "25:00:00 am", "2026-13-01T00:00:00", "nan", "inf"])
def test_what_is_no_time_is_refused_with_the_forms(text: str) -> None:
    with pytest.raises(ConfigError, match="is no time of a recording: give seconds from the start"):
        recorded_time(text)


def test_what_cat_prints_is_what_every_command_takes(recording_of: Callable[[str], Path], tmp_path: Path) -> None:
    path = recording_of("wave")
    code, out, _ = run("bag", "cat", path, "--topics", "afm/state")
    rows = [json.loads(text) for text in out.splitlines()]
    first, last = rows[40]["log_ns"], rows[50]["log_ns"]
    bounds = ("--start", first, "--end", last)
    code, out, err = run("bag", "cat", path, "--topics", "afm/state", *bounds)
    assert code == 0, err
    wanted = [row["log_ns"] for row in rows if first <= row["log_ns"] < last]
    assert [json.loads(text)["log_ns"] for text in out.splitlines()] == wanted
    code, _, err = run("bag", "filter", path, "--topics", "afm/state", *bounds, "--out", tmp_path / "part.mcap")
    assert code == 0, err
    assert [message.log_ns for message in Recording(tmp_path / "part.mcap").messages()] == wanted
    code, _, err = run(
        "bag", "export", path, "--to", "mcap-json", "--topics", "afm/state", *bounds, "--out", tmp_path / "viewer.mcap"
    )
    assert code == 0, err
    assert len(list(Recording(tmp_path / "viewer.mcap").raw())) == len(wanted)
    code, _, err = run("bag", "cat", path, "--start", "1000")
    assert (code, "and has nothing of this choice from 1000 s on" in err) == (1, True)
    assert str(Recording(path).span_ns[0]) in err.replace("\n", "")

from pathlib import Path

import pytest

from proto.errors import ConfigError
from services.delay_node.models import traces
from services.delay_node.models.traces import (
    DelayCourse,
    delay_at,
    parse_delay_trace,
    parse_delivery_trace,
    parse_jitter_table,
    read_text,
)


def test_delay_trace_reads_comments_blanks_and_commas():
    course = parse_delay_trace("# recorded\n0 0.010\n\n0.5, 0.020 # step\n1e0 0\n", "a.txt")
    assert course == DelayCourse((0, 500_000_000, 1_000_000_000), (10_000_000, 20_000_000, 0))


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("0 0.01\n1 0.02\n1 0.03\n", "line 3", "not later than 1.0 s"),
        ("# x\n2 0.01\n1 0.02\n", "line 3", "not later than 2.0 s"),
        ("0 -0.01\n", "line 1", "-0.01 is negative"),
        ("0\n", "line 1", "not a pair"),
        ("0 fast\n", "line 1", "'fast' is not a number"),
        ("0 inf\n", "line 1", "not finite"),
    ],
)
def test_bad_delay_trace_names_file_and_line(text, line, reason):
    with pytest.raises(ConfigError, match=reason) as error:
        parse_delay_trace(text, "wan.txt")
    assert str(error.value).startswith(f"wan.txt, {line}")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1\n3\n2\n", "d.txt, line 3: time 2 is earlier"),
        ("-1\n", "d.txt, line 1: -1 is negative"),
        ("1 2\n", "d.txt, line 1: '1 2' is not one time"),
        ("0\n0\n", "d.txt: the last time is the period"),
        ("# empty\n", "d.txt: the last time is the period"),
    ],
)
def test_bad_delivery_trace_names_file_and_line(text, reason):
    with pytest.raises(ConfigError, match=reason):
        parse_delivery_trace(text, "d.txt", 1e-3)


def test_delivery_trace_in_milliseconds_may_repeat_a_time():
    assert parse_delivery_trace("0\n2\n2\n5", "d.txt", 1e-3) == (0, 2_000_000, 2_000_000, 5_000_000)


def test_bad_jitter_table_names_file_and_line():
    assert parse_jitter_table("# t\n1 -2\n3.5\n", "j") == (1.0, -2.0, 3.5)
    with pytest.raises(ConfigError, match=r"j, line 2: 'x' is not a number"):
        parse_jitter_table("1\nx\n", "j")
    with pytest.raises(ConfigError, match="j: holds no samples"):
        parse_jitter_table("", "j")
    with pytest.raises(ConfigError, match="e: holds no line"):
        parse_delay_trace("", "e")


def test_missing_binary_endless_and_huge_files_are_named(tmp_path, monkeypatch):
    for path in (tmp_path / "none.txt", tmp_path, Path("/dev/zero")):
        with pytest.raises(ConfigError, match=f"{path}: is not a file"):
            read_text(path)
    (tmp_path / "b").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="b: cannot be read"):
        read_text(tmp_path / "b")
    monkeypatch.setattr(traces, "LARGEST_FILE_BYTES", 2)
    with pytest.raises(ConfigError, match="b: is larger than 2 bytes"):
        read_text(tmp_path / "b")


def test_error_shows_little_of_a_file_that_is_no_trace():
    with pytest.raises(ConfigError) as error:
        parse_delay_trace("secret " * 50, "x")
    assert len(str(error.value)) < 120


COURSE = DelayCourse((10, 20, 40), (100, 200, 0))


@pytest.mark.parametrize(
    ("elapsed", "linear", "hold"),
    [(0, 100, 100), (10, 100, 100), (15, 150, 100), (20, 200, 200), (30, 100, 200), (39, 10, 200), (40, 0, 0)],
)
def test_delay_between_lines(elapsed, linear, hold):
    assert delay_at(COURSE, elapsed, interpolation="linear", repeat=False) == linear
    assert delay_at(COURSE, elapsed, interpolation="hold", repeat=False) == hold


def test_after_the_end_the_trace_repeats_or_holds():
    assert delay_at(COURSE, 1000, interpolation="linear", repeat=False) == 0
    assert delay_at(COURSE, 40 * 7 + 15, interpolation="linear", repeat=True) == 150
    assert delay_at(DelayCourse((0,), (5,)), 123, interpolation="linear", repeat=True) == 5

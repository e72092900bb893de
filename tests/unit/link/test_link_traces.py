import traceback
from pathlib import Path

import pytest

from telenano.link.models.courses import delay_at, lost_at
from telenano.settings import link_traces
from telenano.settings.link_traces import (
    DelayCourse,
    parse_delay_trace,
    parse_delivery_trace,
    parse_jitter_table,
    parse_loss_trace,
    read_text,
)
from telenano.wire.errors import ConfigError


def test_delay_trace_reads_comments_blanks_and_commas():
    course = parse_delay_trace("# recorded\n0 0.010\n\n0.5, 0.020 # step\n1e0 0\n", "a.txt")
    assert course == DelayCourse((0, 500_000_000, 1_000_000_000), (10_000_000, 20_000_000, 0))


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("0 0.01\n1 0.02\n1 0.03\n", "line 3", "not later than the one before"),
        ("# x\n2 0.01\n1 0.02\n", "line 3", "not later than the one before"),
        ("0 -0.01\n", "line 1", "is not a number from 0 to 3600"),
        ("0\n", "line 1", "not a pair"),
        ("0 fast\n", "line 1", "is not a number"),
        ("0 inf\n", "line 1", "is not a number from 0 to 3600"),
        ("0 nan\n", "line 1", "is not a number from 0 to 3600"),
        ("0 3601\n", "line 1", "is not a number from 0 to 3600"),
        ("1e300 0\n", "line 1", "is not a number from 0 to 1e\\+09"),
    ],
)
def test_bad_delay_trace_names_file_and_line(text, line, reason):
    with pytest.raises(ConfigError, match=reason) as error:
        parse_delay_trace(text, "wan.txt")
    assert str(error.value).startswith(f"wan.txt, {line}")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1\n3\n2\n", "d.txt, line 3: the time is earlier"),
        ("-1\n", "d.txt, line 1: is not a number from 0 to 1e\\+12"),
        ("1e300\n", "d.txt, line 1: is not a number from 0 to 1e\\+12"),
        ("1 2\n", "d.txt, line 1: is not one time"),
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
    with pytest.raises(ConfigError, match=r"j, line 2: is not a number"):
        parse_jitter_table("1\nx\n", "j")
    for sample in ("1e300", "-inf", "nan"):
        with pytest.raises(ConfigError, match=r"j, line 1: is not a number from -1e\+06 to 1e\+06"):
            parse_jitter_table(sample, "j")
    with pytest.raises(ConfigError, match="j: holds no samples"):
        parse_jitter_table("", "j")
    with pytest.raises(ConfigError, match="e: holds no line"):
        parse_delay_trace("", "e")


def test_missing_binary_endless_and_huge_files_are_named(tmp_path, monkeypatch):
    for path in (tmp_path / "none.txt", tmp_path, Path("/dev/zero")):
        with pytest.raises(ConfigError, match=f"{path}: is not a file"):
            read_text(path)
    (tmp_path / "b").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="b: is not UTF-8 text"):
        read_text(tmp_path / "b")
    monkeypatch.setattr(link_traces, "LARGEST_FILE_BYTES", 2)
    with pytest.raises(ConfigError, match="b: is larger than 2 bytes"):
        read_text(tmp_path / "b")


def test_what_the_kernel_makes_up_while_it_is_read_is_not_a_file_to_read():
    with pytest.raises(ConfigError, match="/proc/self/environ: is empty"):
        read_text(Path("/proc/self/environ"))


@pytest.mark.parametrize(
    "text", ["secret", "12345 secret", "1 2 secret", "0 0\nsecret 1", "5\n4 # secret", "-17", "1e77"]
)
def test_an_error_shows_nothing_of_a_file_that_is_no_trace(text):
    for parse in (parse_delay_trace, parse_jitter_table, lambda text, name: parse_delivery_trace(text, name, 1.0)):
        try:
            parse(text, "x")
        except ConfigError as error:
            # nor does a traceback, which would be in a log
            whole = "".join(traceback.format_exception(error))
            assert not any(word in str(error) + whole for word in ("secret", "12345", "-17", "1e77"))


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


def test_loss_trace_holds_what_a_line_says_until_the_next():
    course = parse_loss_trace("# measured\n0.5 1\n0.7 0\n1.0 1\n", "a.loss")
    at = [0.0, 0.4999, 0.5, 0.69, 0.7, 0.99]
    assert [lost_at(course, round(t * 1e9), repeat=True) for t in at] == [False, False, True, True, False, False]
    # the last time is the period of a trace that repeats, and lasts where it does not
    assert [lost_at(course, round(t * 1e9), repeat=True) for t in (1.2, 1.6, 1.8)] == [False, True, False]
    assert [lost_at(course, round(t * 1e9), repeat=False) for t in (0.8, 1.0, 9.0)] == [False, True, True]


@pytest.mark.parametrize("text", ["0 2", "0 lost", "0", "0 1\n0 0", "-1 0", "# nothing"])
def test_bad_loss_trace_names_the_file(text):
    with pytest.raises(ConfigError, match=r"^wan\.loss"):
        parse_loss_trace(text, "wan.loss")

import io
import json
import logging
import re
import sys

import pytest

from telenano.runtime.loop.log import RateLimitedLog, StructuredLog, configure_logging
from telenano.testing import VirtualClock


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    captured = capsys.readouterr()
    assert captured.out == "", "a log belongs on standard error"
    return captured.err.splitlines()


def test_json_is_one_object_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(as_json=True)
    log = StructuredLog("afm_node@slave")
    log.info("connected", endpoint="tcp://127.0.0.1:1", hz=1000.0, where={"a": (1, 2)})
    log.warning("line\nbreak µ", path=io)
    log.error("stopped")
    entries = [json.loads(line) for line in lines(capsys)]
    assert [entry["level"] for entry in entries] == ["info", "warning", "error"]
    assert {entry["node"] for entry in entries} == {"afm_node@slave"}
    assert (entries[0]["text"], entries[0]["hz"], entries[0]["where"]) == ("connected", 1000.0, {"a": [1, 2]})
    assert entries[1]["text"] == "line\nbreak µ"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", entries[0]["time"])


def test_a_person_gets_a_readable_line(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(as_json=False)
    StructuredLog("afm_node@slave").warning("late", by_s=0.25)
    StructuredLog("afm_node@slave").info("ready")
    first, second = lines(capsys)
    assert re.fullmatch(r"\d\d:\d\d:\d\d\.\d{3} warning afm_node@slave: late  \[by_s=0\.25\]", first)
    assert second.endswith("info    afm_node@slave: ready")


@pytest.mark.parametrize("as_json", [True, False])
def test_other_libraries_and_their_exceptions_come_out_too(as_json: bool, capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(as_json=as_json)
    try:
        raise OSError("gone")
    except OSError:
        logging.getLogger("pymodbus").exception("no answer from %s", "unit 7")
    text = "\n".join(lines(capsys))
    assert "pymodbus" in text
    assert "no answer from unit 7" in text
    assert "OSError: gone" in text
    if as_json:
        assert "OSError: gone" in json.loads(text)["exception"]


def test_debug_of_libraries_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(as_json=True)
    logging.getLogger("numba").debug("bytecode")
    assert lines(capsys) == []


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_decides_where_nobody_does(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    monkeypatch.setattr(sys, "stderr", stream)
    configure_logging()
    StructuredLog("n@s").info("ready")
    assert stream.getvalue().startswith("{") != terminal


def test_a_repeated_warning_is_held_back_and_counted(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging(as_json=True)
    clock = VirtualClock(start_ns=10**12)
    limited = RateLimitedLog(StructuredLog("n@s"), clock, interval_s=1.0)
    for _ in range(2500):
        limited.warning("rejected", "frames refused", count=1)
        clock.advance_ns(1_000_000)
    limited.warning("other", "another kind")
    entries = [json.loads(line) for line in lines(capsys)]
    assert [(entry["text"], entry["held_back"]) for entry in entries] == [
        ("frames refused", 0),
        ("frames refused", 999),
        ("frames refused", 999),
        ("another kind", 0),
    ]


def test_an_unknown_level_is_an_error_of_the_program() -> None:
    with pytest.raises(KeyError):
        StructuredLog("n@s").write("loud", "text")

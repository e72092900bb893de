"""Single keys and a status line: on a terminal, and where there is none."""

import io
import os
import select
import sys
import termios
from collections.abc import Callable, Iterator

import pytest

from telenano.cli.keyboard import RawKeyboard, split_keys

COLUMNS = 30


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], int]]:
    """Make standard input and error a terminal of 30 columns; gives the person's end of it.

    To be called within the test, because the capture of pytest sets standard error again when a test begins.
    """
    person, program = os.openpty()
    with open(program, encoding="utf-8", closefd=False) as stdin, open(program, "w", closefd=False) as stderr:

        def attach() -> int:
            monkeypatch.setenv("TERM", "xterm")
            monkeypatch.setenv("COLUMNS", str(COLUMNS))
            monkeypatch.setattr(sys, "stdin", stdin)
            monkeypatch.setattr(sys, "stderr", stderr)
            return person

        yield attach
    os.close(program)
    os.close(person)


def shown(person: int, last: str) -> str:
    """Read what is shown up to a text; the kernel hands it over when it comes to that."""
    text = ""
    while not text.endswith(last):
        assert select.select([person], [], [], 10.0)[0], text
        text += os.read(person, 1).decode("latin-1")
    return text


def pressed(keys: RawKeyboard, count: int) -> list[str]:
    found: list[str] = []
    while len(found) < count:
        assert select.select([sys.stdin], [], [], 10.0)[0], found
        found += keys.pressed()
    return found


def test_keys_come_one_by_one_without_enter(terminal: Callable[[], int]) -> None:
    person = terminal()
    before = termios.tcgetattr(sys.stdin)
    with RawKeyboard() as keys:
        assert keys.pressed() == []
        os.write(person, b" \x1b[C.\x1b[Dq")
        assert pressed(keys, 5) == ["space", "right", ".", "left", "q"]
        assert keys.pressed() == []
        # Ctrl-C stays a signal
        assert termios.tcgetattr(sys.stdin)[3] & termios.ISIG
    assert termios.tcgetattr(sys.stdin) == before


def test_the_terminal_is_restored_after_an_error(terminal: Callable[[], int]) -> None:
    person = terminal()
    before = termios.tcgetattr(sys.stdin)
    with pytest.raises(ValueError, match="stop"), RawKeyboard() as keys:
        keys.show("recording")
        raise ValueError("stop")
    assert termios.tcgetattr(sys.stdin) == before
    # what is printed next begins on a line of its own, with the cursor
    assert "\n" in shown(person, "\x1b[?25h")


def test_a_status_line_replaces_the_one_before_whole(terminal: Callable[[], int]) -> None:
    person = terminal()
    with RawKeyboard() as keys:
        keys.show("[red] " + "x" * COLUMNS)
        # nothing is lost where the line has no room, and square brackets are no markup
        assert shown(person, "x" * COLUMNS) == "\x1b[?25l[red] \r\n" + "x" * COLUMNS
        keys.show("second")
        # both lines of the first are erased
        assert shown(person, "second").count("\x1b[2K") == 2


def test_without_a_terminal_there_is_no_key_and_no_line(monkeypatch: pytest.MonkeyPatch) -> None:
    stderr = io.StringIO()
    monkeypatch.setattr(sys, "stdin", io.StringIO("q"))
    monkeypatch.setattr(sys, "stderr", stderr)
    with RawKeyboard() as keys:
        keys.show("recording")
        assert keys.pressed() == []
    assert stderr.getvalue() == ""


def test_keys_that_are_not_named_are_their_character() -> None:
    assert split_keys(b"a\x1b[A\x1b[B+") == ["a", "up", "down", "+"]

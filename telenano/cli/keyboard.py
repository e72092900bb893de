"""Single keys and a status line in a terminal, for commands that run until a person ends them."""

import contextlib
import os
import select
import sys
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from telenano.files.optional_modules import optional_module

# Windows has neither: commands are then ended by Ctrl-C alone.
termios = optional_module("termios")
tty = optional_module("tty")

# A terminal sends these bytes for keys that are no character.
_NAMED_KEYS = {b"\x1b[C": "right", b"\x1b[D": "left", b"\x1b[A": "up", b"\x1b[B": "down", b" ": "space"}


class RawKeyboard:
    """Single keys of standard input and a status line on standard error, each only where that is a terminal.

    Ctrl-C stays a signal. Waiting is left to the caller, whose loop waits for other things as well.
    """

    def __init__(self) -> None:
        self._input = sys.stdin.fileno() if termios is not None and sys.stdin.isatty() else None
        terminal = Console(stderr=True)
        # The line has no thread of its own: `show` refreshes it.
        self._line = Live(console=terminal, auto_refresh=False) if terminal.is_terminal else None
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        """Switch the terminal to single keys: no Enter is needed, and nothing is echoed."""
        if self._input is not None:
            before = termios.tcgetattr(self._input)
            self._open.callback(termios.tcsetattr, self._input, termios.TCSADRAIN, before)
            tty.setcbreak(self._input)
        if self._line is not None:
            self._open.enter_context(self._line)
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def pressed(self) -> list[str]:
        """Return the keys pressed since the last call; arrows and the space bar by name."""
        if self._input is None or not select.select([self._input], [], [], 0.0)[0]:
            return []
        return split_keys(os.read(self._input, 64))

    def show(self, line: str) -> None:
        """Show a line instead of the one before; a line that is too long wraps."""
        if self._line is not None:
            self._line.update(Text(line), refresh=True)


def split_keys(data: bytes) -> list[str]:
    """Return the keys in the bytes that a terminal sent."""
    keys: list[str] = []
    while data:
        name = next((sent for sent in _NAMED_KEYS if data.startswith(sent)), data[:1])
        keys.append(_NAMED_KEYS.get(name, name.decode("latin-1")))
        data = data[len(name) :]
    return keys

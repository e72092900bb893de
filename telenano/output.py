"""Output of commands: errors as sentences and exit codes, results as JSON or tables; keys and a status line."""

import contextlib
import json
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NoReturn, Self

import typer
from rich.console import Console

from proto.errors import ConfigError, TelenanoError
from telenano.tables import rows_table, summary_tables

EXIT_FAILED = 1
EXIT_BAD_CONFIGURATION = 2
_PIPE_COLUMNS = 140
_CLEAR_LINE = "\r\x1b[2K"
# what a terminal sends for keys that are no character
_NAMED_KEYS = {b"\x1b[C": "right", b"\x1b[D": "left", b"\x1b[A": "up", b"\x1b[B": "down", b" ": "space"}


@contextlib.contextmanager
def report_errors(as_json: bool, interrupted: str = "interrupted") -> Iterator[None]:
    """Report a TelenanoError or Ctrl-C as a sentence and an exit code; `interrupted` is the text for Ctrl-C."""
    try:
        yield
    except TelenanoError as error:
        code = EXIT_BAD_CONFIGURATION if isinstance(error, ConfigError) else EXIT_FAILED
        fail(str(error), code, as_json=as_json)
    except BrokenPipeError:
        # the reader of the pipe, such as `head`, has closed it: nothing more can be printed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        fail(interrupted, EXIT_FAILED, as_json=as_json)


def fail(text: str, code: int = EXIT_FAILED, *, as_json: bool, **facts: Any) -> NoReturn:
    """Print an error on stderr, with `facts` as JSON on stdout if asked, and exit."""
    typer.echo(f"telenano: {text}", err=True)
    if as_json:
        print_json({"error": text, **facts})
    raise typer.Exit(code)


def print_json(document: Any) -> None:
    """Print one JSON document on a line."""
    typer.echo(json.dumps(document))


def console(pipe_columns: int = _PIPE_COLUMNS) -> Console:
    """Return the console of standard output; a pipe has no width of its own, and a narrow table would lose names."""
    found = Console()
    return found if found.is_terminal else Console(width=pipe_columns)


def print_document(document: dict[str, Any], title: str, *, as_json: bool) -> None:
    """Print a result as JSON or as tables."""
    if as_json:
        print_json(document)
    else:
        console().print(summary_tables(document, title))


def print_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows that have the same keys as a table."""
    console().print(rows_table(rows))


class RawKeyboard:
    """Single keys and a status line on a terminal; no key and no line elsewhere."""

    def __init__(self) -> None:
        self._input = sys.stdin.fileno() if sys.stdin.isatty() else None
        self._show = sys.stderr.isatty()
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        """Switch the terminal to single keys, without Enter."""
        if self._input is not None:
            self._before = termios.tcgetattr(self._input)
            tty.setcbreak(self._input)
        return self

    def __exit__(self, *error: object) -> None:
        if self._input is not None and self._before is not None:
            termios.tcsetattr(self._input, termios.TCSADRAIN, self._before)
        if self._show:
            sys.stderr.write("\n")

    def pressed(self) -> list[str]:
        """Return the keys pressed since the last call; arrows and the space bar by name."""
        if self._input is None or not select.select([self._input], [], [], 0.0)[0]:
            return []
        return split_keys(os.read(self._input, 64))

    def show(self, line: str) -> None:
        if self._show:
            width = os.get_terminal_size(sys.stderr.fileno()).columns
            sys.stderr.write(f"{_CLEAR_LINE}{line[: width - 1]}")
            sys.stderr.flush()


def split_keys(data: bytes) -> list[str]:
    """Return the keys in the bytes that a terminal sent."""
    keys: list[str] = []
    while data:
        name = next((sent for sent in _NAMED_KEYS if data.startswith(sent)), data[:1])
        keys.append(_NAMED_KEYS.get(name, name.decode("latin-1")))
        data = data[len(name) :]
    return keys

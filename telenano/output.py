"""Output of commands: errors as sentences and exit codes, results as JSON or tables."""

import contextlib
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NoReturn

import typer
from rich.console import Console

from proto.errors import ConfigError, TelenanoError
from telenano.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED
from telenano.tables import rows_table, summary_tables

_PIPE_COLUMNS = 140


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

"""A command of `telenano`, in the process of a test or in one of its own."""

import os
import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner

from telenano.cli.root import app


def run(*arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of a command, which raises nothing but its exit."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def run_apart(*arguments: str, timeout_s: float = 240.0, **environment: str) -> "subprocess.CompletedProcess[str]":
    """Return what a command does in a process of its own, at the root of the project and without an input."""
    return subprocess.run(
        [sys.executable, "-m", "telenano", *arguments], cwd=Path(__file__).parents[2], env=os.environ | environment,
        stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8", timeout=timeout_s, check=False,
    )  # fmt: skip

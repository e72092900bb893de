"""Functions that run a command of `telenano`, in the process of a test or in another one."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typer.testing import Result


def invoke(arguments: Sequence[object], **settings: Any) -> "Result":
    """Return the result of a command in this process: `exit_code`, `stdout`, `stderr`, both as `output`, `exception`.

    Args:
        arguments: The words after `telenano`.
        settings: Other arguments of `CliRunner.invoke` of Typer, such as `input` and `env`.
    """
    from typer.testing import CliRunner

    from telenano.cli.root import app

    return CliRunner().invoke(app, [str(argument) for argument in arguments], **settings)


def run(*arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of a command; fail if it raises anything but SystemExit."""
    result = invoke(arguments)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def run_program(*arguments: object) -> int:
    """Run the whole program in this process, with its messages on missing packages, and return the exit code."""
    from telenano.cli.app import main

    words, sys.argv = sys.argv, ["telenano", *map(str, arguments)]
    try:
        main()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    finally:
        sys.argv = words
    return 0


def run_apart(
    *arguments: object, folder: Path | None = None, timeout_s: float = 240.0, **environment: str
) -> "subprocess.CompletedProcess[str]":
    """Run a command in another process without input, in `folder` or that of the tests; return the finished process."""
    return subprocess.run(
        [sys.executable, "-m", "telenano", *map(str, arguments)], cwd=folder, env=os.environ | environment,
        stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8", timeout=timeout_s, check=False,
    )  # fmt: skip


def options_of(*words: str) -> set[str]:
    """Return the long names of the options of a package's command, such as `--json`."""
    from telenano.cli.lazy_commands import load_row, package_commands

    command: Any = load_row(words[-1], package_commands()[words], words)
    return {name for option in command.params for name in option.opts if name.startswith("--")}

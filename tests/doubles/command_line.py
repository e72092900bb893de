"""A command of `telenano` in the process of a test."""

from typer.testing import CliRunner

from telenano.cli.root import app


def run(*arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of a command, which raises nothing but its exit."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr

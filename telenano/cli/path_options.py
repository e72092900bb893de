"""Paths on a command line, looked at before a command begins: what none of them can be is refused by its option.

A path is judged by its name and by what stands there. What a command reads is opened by `open_regular` alone, and may
be gone by then.
"""

import errno
import os
import stat
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from telenano.wire.errors import ConfigError, TelenanoError

# Options and arguments with one of these names of a value take a folder.
_FOLDERS = ("DIR", "FOLDER")
# With these reasons the system reaches nothing by a path, whatever it is wanted for.
_NO_WAY = (errno.ELOOP, errno.ENAMETOOLONG, errno.ENOTDIR, errno.EINVAL)


def check_paths(command: Any) -> None:
    """Have a command of typer refuse the paths that cannot be, in all of its options and arguments that take some."""
    for parameter in command.params:
        if parameter.type_descriptor.annotation in (Path, list[Path]):
            parameter.consume_value = partial(_checked, parameter.consume_value, parameter)


def _checked(consume: Callable[..., Any], parameter: Any, *args: Any) -> Any:
    """Return what a person gave for a parameter, with its source; TelenanoError names what is no path."""
    value, source = consume(*args)
    name = parameter.opts[0] if parameter.param_type_name == "option" else parameter.metavar or parameter.name
    for text in value if isinstance(value, list | tuple) else [value]:
        if isinstance(text, str):
            is_read = parameter.param_type_name == "argument"
            _check(name, text, is_folder=parameter.metavar in _FOLDERS, is_read=is_read)
    return value, source


def _check(name: str, text: str, *, is_folder: bool, is_read: bool) -> None:
    if not text:
        # `Path` takes it for the current folder.
        raise ConfigError(f"{name}: is empty, as an unset variable is; write . for the current folder")
    if "\0" in text:
        raise ConfigError(f"{name} {text}: has a character that no path can have")
    try:
        mode = os.stat(text).st_mode  # noqa: PTH116  A Path of this text may be another one.
    except OSError as error:
        if error.errno in _NO_WAY:
            raise TelenanoError(f"{text}: cannot be reached, as {name} asks: {error.strerror}") from error
        return
    # A command that reads a folder knows best what another file is, and where it should have gone.
    if is_folder and not stat.S_ISDIR(mode) and not (is_read and stat.S_ISREG(mode)):
        what = "file" if stat.S_ISREG(mode) else "pipe, socket or device"
        raise TelenanoError(f"{text}: cannot be the folder of {name}: it is a {what}: {os.strerror(errno.ENOTDIR)}")

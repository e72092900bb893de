"""Check the paths on a command line before a command begins: an unusable path is refused with the name of its option.

A path is judged by its text and by the kind of file that it leads to. This reserves nothing: a command opens the files
that it reads with `open_regular`, and they may be gone by then.
"""

import errno
import os
import stat
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from telenano.wire.errors import ConfigError, TelenanoError

# Options and arguments with one of these metavars take a folder.
_FOLDERS = ("DIR", "FOLDER")
# Errors with which a path is unusable for any purpose.
_NO_WAY = (errno.ELOOP, errno.ENAMETOOLONG, errno.ENOTDIR, errno.EINVAL)


def check_paths(command: Any) -> None:
    """Make a command of typer refuse unusable paths, in all of its options and arguments that take paths."""
    for parameter in command.params:
        if parameter.type_descriptor.annotation in (Path, list[Path]):
            parameter.consume_value = partial(_checked, parameter.consume_value, parameter)


def _checked(consume: Callable[..., Any], parameter: Any, *args: Any) -> Any:
    """Return the value that a person gave for a parameter, with its source; TelenanoError for an unusable path."""
    value, source = consume(*args)
    name = parameter.opts[0] if parameter.param_type_name == "option" else parameter.metavar or parameter.name
    for text in value if isinstance(value, list | tuple) else [value]:
        if isinstance(text, str):
            is_read = parameter.param_type_name == "argument"
            _check(name, text, is_folder=parameter.metavar in _FOLDERS, is_read=is_read)
    return value, source


def _check(name: str, text: str, *, is_folder: bool, is_read: bool) -> None:
    if not text:
        # `Path("")` would be the current folder.
        raise ConfigError(f"{name}: is empty, as an unset variable is; write . for the current folder")
    if "\0" in text:
        raise ConfigError(f"{name} {text}: has a character that no path can have")
    try:
        mode = os.stat(text).st_mode  # noqa: PTH116  A Path of this text may be another one.
    except OSError as error:
        if error.errno in _NO_WAY:
            raise TelenanoError(f"{text}: cannot be reached, as {name} asks: {error.strerror}") from error
        return
    # A command that reads a folder can say best why a file is given instead, and what to do.
    if is_folder and not stat.S_ISDIR(mode) and not (is_read and stat.S_ISREG(mode)):
        what = "file" if stat.S_ISREG(mode) else "pipe, socket or device"
        raise TelenanoError(f"{text}: cannot be the folder of {name}: it is a {what}: {os.strerror(errno.ENOTDIR)}")

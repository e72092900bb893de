"""Check the paths on a command line before a command begins: an unusable path is refused with the name of its option.

A path is judged by its text and by the kind of file that it leads to. This reserves nothing: a command opens the files
that it reads with `open_regular`, and they may be gone by then.
"""

import errno
import os
import stat
from typing import Any

from telenano.wire.errors import ConfigError, TelenanoError

# Options and arguments with one of these metavars take a folder.
_FOLDERS = ("DIR", "FOLDER")
# Errors with which a path is unusable for any purpose.
_NO_WAY = (errno.ELOOP, errno.ENAMETOOLONG, errno.ENOTDIR, errno.EINVAL)


def check_path(parameter: Any, text: str) -> None:
    """Raise TelenanoError if the text of an option or argument of typer that takes a path is unusable as one."""
    is_option = parameter.param_type_name == "option"
    name = parameter.opts[0] if is_option else parameter.metavar or parameter.name
    _check(name, text, is_folder=parameter.metavar in _FOLDERS, is_read=not is_option)


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

"""Standard output and standard error of the command line, made printable (`telenano.wire.printable`)."""

import codecs
import sys
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TextIO

from telenano.wire.printable import printable

STREAMS = {"stdout": "standard output", "stderr": "standard error"}


class NamedStream:
    """A text stream whose errors carry its name, like those of a file; all else passes to the stream behind it."""

    def __init__(self, stream: Any, name: str) -> None:
        self._stream, self._name = stream, name

    def __getattr__(self, name: str) -> Any:
        attribute = getattr(self._stream, name)
        return partial(self._named, attribute) if name in ("write", "flush") else attribute

    def _named(self, method: Callable[..., Any], *arguments: str) -> Any:
        try:
            return method(*arguments)
        except OSError as error:
            error.filename = self._name
            raise


class PrintableStream(NamedStream):
    """A text stream that replaces characters which a terminal would obey.

    Rich sends control sequences to draw its tables, and uses the stream behind this one (`rich_proxied_file`); the
    console (`telenano.cli.output.console`) makes the text in its tables printable.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self.rich_proxied_file = NamedStream(stream, name)
        super().__init__(stream, name)

    def write(self, text: str) -> int:
        self._named(self._stream.write, printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        # Bytes would bypass this stream, and typer writes bytes to a stream whose encoding is ASCII.
        if name == "buffer":
            raise AttributeError(name)
        return super().__getattr__(name)


def install() -> None:
    """Make the output of this process printable from now on."""
    for name, title in STREAMS.items():
        stream = getattr(sys, name)
        # A process without a terminal or a pipe has no such stream.
        if stream is not None and not isinstance(stream, PrintableStream):
            # An encoding that lacks a character writes the number of the character.
            if codecs.lookup(stream.encoding or "utf-8").name != "utf-8" and hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="backslashreplace")
            setattr(sys, name, PrintableStream(stream, title))

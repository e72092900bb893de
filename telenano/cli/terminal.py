"""Standard output and errors of the command line: what is printed on them is text (`telenano.wire.printable`)."""

import codecs
import sys
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TextIO

from telenano.wire.printable import printable

STREAMS = {"stdout": "standard output", "stderr": "standard error"}


class NamedStream:
    """A text stream whose errors have its name, as those of a file have; everything else is the stream behind it."""

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
    """A text stream that writes out what a terminal would obey.

    Rich sends the orders that draw its tables, and takes the stream behind this one (`rich_proxied_file`): the text in
    its tables is made printable by the console (`telenano.cli.output.console`).
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
        # bytes would be written past this stream, as typer does where the stream is of ASCII only
        if name == "buffer":
            raise AttributeError(name)
        return super().__getattr__(name)


def install() -> None:
    """Make what this process prints from now on printable."""
    for name, title in STREAMS.items():
        stream = getattr(sys, name)
        # A process without a terminal or a pipe has no such stream.
        if stream is not None and not isinstance(stream, PrintableStream):
            # An encoding that has not every character writes the number of one that it has not.
            if codecs.lookup(stream.encoding or "utf-8").name != "utf-8" and hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="backslashreplace")
            setattr(sys, name, PrintableStream(stream, title))

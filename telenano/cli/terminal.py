"""Standard output and errors of the command line: what is printed on them is text (`untrusted.printable`)."""

import codecs
import sys
from collections.abc import Iterable
from typing import Any, TextIO

from services.runtime.untrusted.printable import printable


class PrintableStream:
    """A text stream that writes out what a terminal would obey; everything else is the stream behind it.

    Rich sends the orders that draw its tables, and takes the stream behind this one (`rich_proxied_file`): the text in
    its tables is made printable by the console (`telenano.cli.output.console`).
    """

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        self.rich_proxied_file.write(printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        # bytes would be written past this stream, as typer does where the stream is of ASCII only
        if name == "buffer":
            raise AttributeError(name)
        return getattr(self.rich_proxied_file, name)


def install() -> None:
    """Make what this process prints from now on printable."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        # A process without a terminal or a pipe has no such stream.
        if stream is not None and not isinstance(stream, PrintableStream):
            if codecs.lookup(stream.encoding or "utf-8").name == "ascii":
                stream.reconfigure(errors="backslashreplace")
            setattr(sys, name, PrintableStream(stream))

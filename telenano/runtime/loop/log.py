"""Structured logs on standard error: one JSON object a line, or one readable line on a terminal."""

import json
import logging
import sys
import time
from typing import Any

from telenano.timing.clock import Clock
from telenano.wire.printable import printable

# Number of records that a library may log at once.
_LIBRARY_BURST = 20.0
# Number of records per second that it may log after that.
_LIBRARY_PER_S = 1.0
_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class StructuredLog:
    """The log of one node: a sentence and its facts, as `log.info("connected", endpoint=...)`."""

    def __init__(self, node: str) -> None:
        self._logger = logging.getLogger(node)
        self._node = node

    def info(self, text: str, **facts: Any) -> None:
        self.write("info", text, **facts)

    def warning(self, text: str, **facts: Any) -> None:
        self.write("warning", text, **facts)

    def error(self, text: str, **facts: Any) -> None:
        self.write("error", text, **facts)

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Log at a level given by name: info, warning or error."""
        self._logger.log(_LEVELS[level], text, extra={"node": self._node, "facts": facts})


class RateLimitedLog:
    """Logs each kind of message at most once per interval [s], with the number of suppressed ones."""

    def __init__(self, log: StructuredLog, clock: Clock, interval_s: float = 1.0) -> None:
        self._log = log
        self._clock = clock
        self._interval_ns = round(interval_s * 1e9)
        self._next_ns: dict[str, int] = {}
        self._held_back: dict[str, int] = {}

    def warning(self, kind: str, text: str, **facts: Any) -> None:
        """Log a warning, or only count it if one of its kind was logged less than an interval ago."""
        now = self._clock.monotonic_ns()
        if now < self._next_ns.get(kind, now):
            self._held_back[kind] = self._held_back.get(kind, 0) + 1
            return
        self._next_ns[kind] = now + self._interval_ns
        self._log.warning(text, **facts, held_back=self._held_back.pop(kind, 0))


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        entry = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "node": getattr(record, "node", record.name),
            "text": record.getMessage(),
            **getattr(record, "facts", {}),
        }
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, default=str)


class _PersonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        facts = " ".join(f"{key}={value}" for key, value in getattr(record, "facts", {}).items())
        stamp = time.strftime("%H:%M:%S", time.localtime(record.created)) + f".{int(record.msecs):03d}"
        line = f"{stamp} {record.levelname.lower():7} {getattr(record, 'node', record.name)}: {record.getMessage()}"
        line += f"  [{facts}]" if facts else ""
        line += "\n" + self.formatException(record.exc_info) if record.exc_info else ""
        return printable(line)


class _LibraryLimiter(logging.Filter):
    """Passes a burst of each library's records and then one per second, so that a peer cannot fill the disk with logs.

    Records of nodes pass always; nodes limit them themselves.
    """

    def __init__(self) -> None:
        super().__init__()
        self._left: dict[str, float] = {}
        self._at_s: dict[str, float] = {}
        self._held_back: dict[str, int] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        if hasattr(record, "node"):
            return True
        now_s, name = time.monotonic(), record.name
        left = self._left.get(name, _LIBRARY_BURST) + _LIBRARY_PER_S * (now_s - self._at_s.get(name, now_s))
        self._at_s[name] = now_s
        passes = left >= 1.0
        self._left[name] = min(left - passes, _LIBRARY_BURST)
        if not passes:
            self._held_back[name] = self._held_back.get(name, 0) + 1
        elif held_back := self._held_back.pop(name, 0):
            record.facts = {"held_back": held_back}
        return passes


def configure_logging(*, as_json: bool | None = None) -> None:
    """Send the logs of this process to standard error, by default as JSON unless that is a terminal."""
    handler = logging.StreamHandler(sys.stderr)
    as_json = not sys.stderr.isatty() if as_json is None else as_json
    handler.addFilter(_LibraryLimiter())
    handler.setFormatter(_JsonFormatter() if as_json else _PersonFormatter())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.INFO)

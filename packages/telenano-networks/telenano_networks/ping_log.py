"""Read what `ping` printed: the round trips of a measured network.

Lines of other tools than the `ping` of Linux, BSD, macOS and Windows are not read; what they call the time is that of
any language (`time=42 ms`, `Zeit=42ms`). `ping -D` prints the time of each answer, and so does what puts a date in
front of each line. Without them the packets are taken as sent at even distances, of which the last lines say how long
all of them took.
"""

import re
from datetime import datetime
from pathlib import Path

from proto.errors import ConfigError

_TIME = r"\b[^\W\d]+[=<](?P<ms>\d+(?:[.,]\d+)?) ?(?:ms|мс)"
_STAMP = r"\[(?P<stamp>\d+\.\d+|\d{4}-\d\d-\d\d[ T][\d:.]+)\] "
_ANSWER = re.compile(rf"^(?:{_STAMP})?.*?{_TIME}", re.IGNORECASE)
# the last lines: how many packets, and how long all of them took
_TOTAL = re.compile(r"(\d+) packets transmitted.* time (\d+) ?ms")
_NUMBER = re.compile(r"\bicmp_seq[= ](\d+)")
_HEADS = ("PING ", "Pinging ")
_HEAD = re.compile(rf"^(?:{_STAMP})?(?:PING|Pinging) ")


def is_ping_file(path: Path) -> bool:
    """Return whether a file begins as what `ping` prints does."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.read(64).lstrip().startswith(_HEADS)
    except OSError:
        return False


def is_ping_log(text: str) -> bool:
    """Return whether a text is what `ping` printed, by its first line or its first answer."""
    return any(_HEAD.match(line) or _ANSWER.match(line) for line in text.splitlines()[:20])


def round_trips(text: str, name: str) -> list[tuple[float, float]]:
    """Return the time since the first packet and the round trip [s] of each packet, nan where no answer came.

    A packet without an answer left between its neighbours, at even distances. Without any answer there are no rows.

    Raises:
        ConfigError: An answer has no `icmp_seq` by which a lost packet is known, or no time.
    """
    found: dict[int, tuple[float, float]] = {}
    total = _TOTAL.search(text)
    period_s = 1e-3 * int(total[2]) / max(int(total[1]) - 1, 1) if total else 0.0
    for line, row in enumerate(text.splitlines(), start=1):
        answer = _ANSWER.match(row)
        if answer is None or "(DUP!)" in row:
            continue
        sequence = _NUMBER.search(row)
        if sequence is None:
            raise ConfigError(f"{name}, line {line}: has no icmp_seq, by which a lost packet is known")
        if answer["stamp"] is None and not total:
            raise ConfigError(
                f"{name}, line {line}: has no time; let `ping -D` print one, or keep the last lines of the log, which"
                " say how long all took"
            )
        trip_s = 1e-3 * float(answer["ms"].replace(",", "."))
        number = int(sequence[1])
        # The sixteen bits of the number begin anew after 65535.
        if found and number < max(found) - 32768:
            number += 65536 * ((max(found) - number + 32768) // 65536)
        at_s = number * period_s if answer["stamp"] is None else _seconds(answer["stamp"]) - trip_s
        found.setdefault(number, (at_s, trip_s))
    numbers = sorted(found)
    if not numbers:
        return []
    first_s = found[numbers[0]][0]
    rows: list[tuple[float, float]] = []
    for number, after in zip(numbers, [*numbers[1:], -1], strict=True):
        begin_s, trip_s = found[number]
        rows.append((begin_s - first_s, trip_s))
        step_s = (found[after][0] - begin_s) / (after - number) if after > 0 else 0.0
        rows += [(begin_s - first_s + n * step_s, float("nan")) for n in range(1, after - number)]
    return rows


def _seconds(stamp: str) -> float:
    # Only differences count, so that no time zone is needed.
    return float(stamp) if stamp.replace(".", "").isdigit() else datetime.fromisoformat(f"{stamp}+00:00").timestamp()

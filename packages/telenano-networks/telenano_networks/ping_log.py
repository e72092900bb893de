"""Read what `ping` printed: the round trips of a measured network.

Lines of other tools than the `ping` of Linux, BSD, macOS and Windows are not read; what they call the time is that of
any language (`time=42 ms`, `Zeit=42ms`). `ping -D` prints the time of each
answer; without it the packets are taken as sent once a second, which is what `ping` does unless told otherwise.
"""

import re
from pathlib import Path

from proto.errors import ConfigError

_TIME = r"\b[^\W\d]+[=<](?P<ms>\d+(?:[.,]\d+)?) ?(?:ms|мс)"
_ANSWER = re.compile(rf"^(?:\[(?P<stamp>\d+\.\d+)\] )?.*?{_TIME}", re.IGNORECASE)
_NUMBER = re.compile(r"\bicmp_seq[= ](\d+)")
_HEADS = ("PING ", "Pinging ")


def is_ping_file(path: Path) -> bool:
    """Return whether a file begins as what `ping` prints does."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.read(64).lstrip().startswith(_HEADS)
    except OSError:
        return False


def is_ping_log(text: str) -> bool:
    """Return whether a text is what `ping` printed, by its first line or its first answer."""
    return any(line.startswith(_HEADS) or _ANSWER.match(line) for line in text.splitlines()[:20])


def round_trips(text: str, name: str) -> list[tuple[float, float]]:
    """Return the time since the first packet and the round trip [s] of each packet, nan where no answer came.

    A packet without an answer left between its neighbours, at even distances.

    Raises:
        ConfigError: Nothing answered, or an answer has no `icmp_seq` by which a lost packet is known, or no time.
    """
    found: dict[int, tuple[float, float]] = {}
    for line, row in enumerate(text.splitlines(), start=1):
        answer = _ANSWER.match(row)
        if answer is None or "(DUP!)" in row:
            continue
        sequence = _NUMBER.search(row)
        if sequence is None:
            raise ConfigError(f"{name}, line {line}: has no icmp_seq, by which a lost packet is known")
        if answer["stamp"] is None:
            raise ConfigError(f"{name}, line {line}: has no time; let `ping -D` print one")
        trip_s = 1e-3 * float(answer["ms"].replace(",", "."))
        number = int(sequence[1])
        # The sixteen bits of the number begin anew after 65535.
        if found and number < max(found) - 32768:
            number += 65536 * ((max(found) - number + 32768) // 65536)
        found.setdefault(number, (float(answer["stamp"]) - trip_s, trip_s))
    if not found:
        raise ConfigError(f"{name}: is a log of ping without an answer")
    numbers = sorted(found)
    first_s = found[numbers[0]][0]
    rows: list[tuple[float, float]] = []
    for number, after in zip(numbers, [*numbers[1:], numbers[-1] + 1], strict=True):
        begin_s, trip_s = found[number]
        rows.append((begin_s - first_s, trip_s))
        step_s = (found[after][0] - begin_s) / (after - number) if after in found else 0.0
        rows += [(begin_s - first_s + n * step_s, float("nan")) for n in range(1, after - number)]
    return rows

"""Read what `ping` printed: the delays of a measured network, half of each round trip for one way.

Lines of other tools than the `ping` of Linux, BSD, macOS and Windows are not read. `ping -D` prints the time of each
answer, which a course over time needs; the distribution of the delays needs none.
"""

import re
from typing import NamedTuple

from proto.errors import ConfigError

_ANSWER = re.compile(r"^(?:\[(?P<stamp>\d+\.\d+)\] )?.*?\btime[=<](?P<ms>\d+(?:[.,]\d+)?) ?ms", re.IGNORECASE)
_NUMBER = re.compile(r"\bicmp_seq[= ](\d+)")


class Answer(NamedTuple):
    """An answer: its line, the packet's number and the time [s] where they are printed, half the round trip [s]."""

    line: int
    number: int | None
    stamp_s: float | None
    delay_s: float


def is_ping_log(text: str) -> bool:
    """Return whether a text is what `ping` printed, by its first line or its first answer."""
    return any(line.startswith(("PING ", "Pinging ")) or _ANSWER.match(line) for line in text.splitlines()[:20])


def answers(text: str, name: str) -> list[Answer]:
    """Return the answers of a log in the order of its lines; ConfigError where nothing answered."""
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        answer = _ANSWER.match(line)
        if answer is None or "(DUP!)" in line:
            continue
        sequence = _NUMBER.search(line)
        found.append(
            Answer(
                number,
                int(sequence[1]) if sequence else None,
                float(answer["stamp"]) if answer["stamp"] else None,
                0.5e-3 * float(answer["ms"].replace(",", ".")),
            )
        )
    if not found:
        raise ConfigError(f"{name}: is a log of ping without an answer")
    return found


def delays(text: str, name: str) -> list[tuple[int, float, float]]:
    """Return line, time since the first packet and delay [s] of each answer; ConfigError where the log has no times."""
    return [(answer.line, time_s, answer.delay_s) for time_s, answer in _timed(text, name)]


def losses(text: str, name: str) -> list[tuple[int, float, bool]]:
    """Return line, time since the first packet [s], and whether a packet was lost, for each packet by its number.

    A packet without an answer left between its neighbours, at even distances; its line is that of the next answer.
    """
    found: list[tuple[int, float, bool]] = []
    before: tuple[float, Answer] | None = None
    for time_s, answer in _timed(text, name):
        if answer.number is None:
            raise ConfigError(f"{name}, line {answer.line}: has no icmp_seq, by which a lost packet is known")
        if before is not None and before[1].number is not None:
            gap = answer.number - before[1].number
            step_s = (time_s - before[0]) / max(gap, 1)
            found += [(answer.line, before[0] + n * step_s, True) for n in range(1, gap)]
        found.append((answer.line, time_s, False))
        before = (time_s, answer)
    return found


def _timed(text: str, name: str) -> list[tuple[float, Answer]]:
    """Return the answers with the times [s] at which their packets left, in that order, the first at 0."""
    found = []
    for answer in answers(text, name):
        if answer.stamp_s is None:
            raise ConfigError(
                f"{name}, line {answer.line}: has no time; let `ping -D` print one, or name the log in "
                "jitter.table_file, which needs none"
            )
        found.append((answer.stamp_s - 2.0 * answer.delay_s, answer))
    found.sort(key=lambda pair: pair[0])
    first_s = found[0][0]
    return [(time_s - first_s, answer) for time_s, answer in found]

"""The table of docs/verdicts.md, made from the comments and values of `telenano.analysis.verdict_thresholds`."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "verdicts.md"
_SOURCE = ROOT / "telenano" / "analysis" / "verdict_thresholds.py"
_HEAD = "| threshold | value | of what | reason |\n|---|---|---|---|\n"
_ONE = re.compile(r"((?:# .*\n)+)([A-Z_]+) = (.+)\n")


def rows() -> list[tuple[str, str, str, str]]:
    """Return name, value, quantity with its unit, and reason of each threshold.

    Raises:
        ValueError: A comment is not "quantity [unit]: reason"; the message names the threshold.
    """
    found = []
    for comment, name, value in _ONE.findall(_SOURCE.read_text("utf-8")):
        text = " ".join(line.removeprefix("# ") for line in comment.splitlines())
        of_what, colon, reason = text.partition("]: ")
        if not colon:
            raise ValueError(f"{name}: its comment is {text!r}, and not 'quantity [unit]: reason'")
        found.append((name, value, of_what.replace(" [1", "").replace("[", "in "), reason))
    return found


def with_table(page: str) -> str:
    """Return the text of the page with the table of today."""
    first = page.index(_HEAD.partition("\n")[0])
    last = page.index("\n\n", first)
    table = "\n".join(f"| `{name}` | {value} | {what} | {reason} |" for name, value, what, reason in rows())
    return page[:first] + _HEAD + table + page[last:]

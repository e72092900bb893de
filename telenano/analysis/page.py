"""Self-contained HTML pages for a study, a take or a budget, with embedded figures and no external resource."""

import base64
import io
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from telenano.analysis.figure_style import VERDICT_COLOURS
from telenano.recording.provenance import versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
:root { color-scheme: light dark; --line: #8886; --soft: #8882; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 90rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; }
img { max-width: 100%; background: #fff; border: 1px solid var(--line); }
table { border-collapse: collapse; font-size: .92rem; display: block; overflow-x: auto; }
th, td { padding: .25rem .7rem; border-bottom: 1px solid var(--line); text-align: right; }
td { white-space: nowrap; } td.words { white-space: normal; min-width: 14rem; text-align: left; }
@page { size: A4 landscape; margin: 12mm; }
@media print {
  body { max-width: none; margin: 0; font-size: 10px; }
  table { display: table; overflow: visible; font-size: 8px; width: 100%; }
  th, td { padding: .1rem .25rem; } td { white-space: normal; } tr, img { break-inside: avoid; }
}
th:first-child, td:first-child { text-align: left; }
code { background: var(--soft); padding: .1rem .3rem; }
footer { margin-top: 3rem; border-top: 1px solid var(--line); font-size: .85rem; color: #888; }
""" + "\n".join(
    f".{kind} {{ background: {colour}66; border-left: 4px solid {colour}; }}"
    for kind, colour in VERDICT_COLOURS.items()
)
_DPI = 140
_TABLES = (".parquet", ".csv", ".json")
# length of the longest number in a cell; a longer text is broken into lines [characters]
_LONGEST_FIGURE = 32


def cell_text(value: Any) -> str:
    """Return a value as text for a table, with a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


class Page:
    """A page under construction; every text that is added to it is escaped."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts = [f"<h1>{escape(title)}</h1>"]

    def heading(self, words: str) -> None:
        self._parts.append(f"<h2>{escape(words)}</h2>")

    def paragraph(self, words: str) -> None:
        self._parts.append(f"<p>{escape(words)}</p>")

    def code(self, words: str) -> None:
        self._parts.append(f"<p><code>{escape(words)}</code></p>")

    def table(self, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """Add a table; a cell with the name of a verdict gets its colour."""
        header = "".join(f"<th>{escape(name)}</th>" for name in head)
        body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
        self._parts.append(f"<table><thead><tr>{header}</tr></thead><tbody>{body}</tbody></table>")

    def image(self, png: bytes, words: str) -> None:
        data = base64.b64encode(png).decode()
        alt = escape(words, quote=True)
        self._parts.append(f'<p><img src="data:image/png;base64,{data}" alt="{alt}"></p><p>{escape(words)}</p>')

    def write(self, path: Path) -> None:
        """Write the page, with the versions that made it, and links to the tables in its folder."""
        versions_here = versions()
        words = ", ".join(
            f"{name} {versions_here[key]}"
            for name, key in (("telenano", "package telenano"), ("commit", "commit"), ("Python", "python"),
                              ("NumPy", "package numpy"), ("on", "platform"))
        )  # fmt: skip
        made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        tables = sorted(p.name for kind in _TABLES for p in path.parent.glob(f"*{kind}"))
        links = "".join(f' · <a href="{escape(name, quote=True)}">{escape(name)}</a>' for name in tables)
        title = f"<title>{escape(self._title)}</title>"
        head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width">{title}'
        body = "\n".join([*self._parts, f"<footer><p>Made {made} by {escape(words)}{links}</p></footer>"])
        head += f"<style>{_STYLE}</style>"
        document = f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n</body></html>\n'
        path.write_text(document, encoding="utf-8")


def _cell(value: Any) -> str:
    verdict = value if value in VERDICT_COLOURS else ""
    words = cell_text(value).replace("_", " ") if verdict else cell_text(value)
    # Sentences are broken into lines, so that no table is wider than its page.
    kind = verdict or ("words" if len(words) > _LONGEST_FIGURE else "")
    return f'<td class="{kind}">{escape(words)}</td>' if kind else f"<td>{escape(words)}</td>"


def png_of(figure: "Figure") -> bytes:
    """Return a figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()

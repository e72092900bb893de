"""Style and formats of figures: for a screen, or for a column of a journal.

Readers with deuteranopia and protanopia can distinguish the colours (CIEDE2000 of at least 20 between the verdicts).
So can readers of a print in grey: curves and verdicts also differ in lightness, and lines in their style.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from telenano.wire.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("png", "pdf", "svg")
STYLES = ("screen", "paper")
# Lines need 600 in print; text and lines of PDF and SVG have no resolution.
_DOTS_PER_INCH = {"screen": 130, "paper": 600}
_PAPER: Mapping[str, Any] = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "figure.titlesize": 8.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
}
# Text of a PDF or SVG stays text, which an editor of the journal can search and typeset.
_EVERYWHERE: Mapping[str, Any] = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "telenano"}

# The colours of verdicts maximise the least difference between any two, with stable light and diverged dark.
VERDICT_COLOURS = {
    "stable": "#99e6ff",
    "limit_cycle": "#e68000",
    "diverged": "#66004d",
    "contact_lost": "#0000e6",
    "guarded": "#001a00",
    "no_data": "#ffffe6",
    "cannot_say": "#4d4d00",
}
# The colours of curves.
HAND = "#0b3d66"
TIP = "#d55e00"


@dataclass(frozen=True)
class FigureOptions:
    """Formats in which figures are written, and their style, `screen` or `paper`."""

    formats: tuple[str, ...] = ("png",)
    style: str = "screen"

    # width of one column in most journals of the field [inch]
    COLUMN_IN: ClassVar[float] = 3.5
    # colour of a curve that others are compared with
    REFERENCE: ClassVar[str] = "#9a9a9a"

    @classmethod
    def of(cls, formats: str = "png", style: str = "screen") -> Self:
        """Parse formats such as `png,pdf,svg`, and a style; ConfigError lists the known ones."""
        chosen = tuple(dict.fromkeys(part.strip().lower() for part in formats.split(",") if part.strip()))
        for name in chosen:
            if name not in FORMATS:
                raise ConfigError(f"--format {name}: is not one of {', '.join(FORMATS)}")
        if not chosen:
            raise ConfigError(f"--format: name at least one of {', '.join(FORMATS)}")
        if style not in STYLES:
            raise ConfigError(f"--style {style}: is not one of {', '.join(STYLES)}")
        return cls(chosen, style)

    @contextmanager
    def styled(self) -> Iterator[None]:
        """Draw in this style while the block runs."""
        import matplotlib

        settings: Any = {**_EVERYWHERE, **(_PAPER if self.style == "paper" else {})}
        with matplotlib.rc_context(settings):
            yield

    def lettered(self, panels: "Sequence[Axes]") -> None:
        """Write (a), (b), (c) … above the left corner of each panel; a single panel gets none."""
        if len(panels) < 2:
            return
        for number, panel in enumerate(panels):
            panel.set_title(f"({chr(ord('a') + number)})", loc="left", fontsize=8 if self.style == "paper" else 10)

    def drawn(self, figure: "Figure", stem: str, origin: str = "") -> dict[str, bytes]:
        """Return the contents of a figure's files, by name; each file contains its origin in words.

        Args:
            figure: The figure.
            stem: The name of its files without the ending.
            origin: The origin of the figure in words: the Description of PNG and SVG, the Subject of PDF.
        """
        files = {}
        for name in self.formats:
            buffer = io.BytesIO()
            # The files contain no date, so that the same session gives the same bytes.
            metadata = {
                "png": {"Description": origin},
                "pdf": {"Subject": origin, "CreationDate": None},
                "svg": {"Description": origin, "Date": None},
            }[name]
            with self.styled():
                figure.savefig(buffer, format=name, dpi=_DOTS_PER_INCH[self.style], metadata=metadata)
            files[f"{stem}.{name}"] = buffer.getvalue()
        return files


ON_SCREEN = FigureOptions()

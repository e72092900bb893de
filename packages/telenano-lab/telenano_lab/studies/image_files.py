"""Write images and tables of studies as files, in the chosen formats."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from telenano.analysis import FigureOptions, png_of
from telenano.recording import versions
from telenano.settings import flatten
from telenano_lab.studies.figure_colours import ON_SCREEN
from telenano_lab.studies.table_files import table_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_images(
    out: Path, figures: "Mapping[str, Figure]", command: str, options: FigureOptions = ON_SCREEN
) -> dict[str, bytes]:
    """Write figures into a folder in their formats; return each as PNG, by file name, for a page.

    Args:
        out: The folder.
        figures: The figures by name.
        command: The command that makes them; each file contains it together with the version.
        options: The formats and the style of the figures.
    """
    versions_here = versions()
    origin = f"{command}; telenano {versions_here['package telenano']}, commit {versions_here['commit']}"
    for stem, figure in figures.items():
        for name, content in options.drawn(figure, stem, origin).items():
            (out / name).write_bytes(content)
    return {f"{stem}.png": png_of(figure) for stem, figure in figures.items()}


def write_tables(
    folder: Path, name: str, rows: Sequence[Mapping[str, Any]], formats: Sequence[str] = ("parquet",)
) -> None:
    """Write rows as NAME.FORMAT in the formats of `studies.table_files`; nested keys become dotted columns."""
    for file, content in table_files(name, [flatten(row) for row in rows], formats).items():
        (folder / file).write_bytes(content)

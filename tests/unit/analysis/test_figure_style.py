"""Figures can be read by the colour-blind and in grey, and be printed in a journal."""

import io
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from telenano.analysis.fig12 import SessionSeries, draw_fig12, fig12_files
from telenano.analysis.figure_style import FigureOptions
from telenano.wire.errors import ConfigError


def series() -> SessionSeries:
    time_s = np.linspace(0.0, 8.0, 801)
    press = np.clip(time_s - 1.0, 0.0, 1.0) - np.clip(time_s - 5.0, 0.0, 1.0)
    separation_m = 1e-8 * (1.0 - 0.98 * press)
    # it jumps to the sample from 2.4 nm, and off again from 4 nm
    separation_m[(press > 0.78) & (time_s < 4.0)] = 2e-10
    separation_m[(press > 0.62) & (time_s > 4.0)] = 2e-10
    return SessionSeries(time_s, press, 1e-2 * press, time_s, 1e-2 * press, time_s, 1e-8 * press, separation_m, 1e8)


def test_the_figure_has_letters_and_two_styles_of_line_for_the_two_ways() -> None:
    figure = draw_fig12(series(), "title")
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["(a)", "(b)", "(c)"]
    labels = [text.get_text() for text in figure.axes[2].get_legend().get_texts()]
    assert labels == ["approach", "retraction"]
    styles = {line.get_linestyle() for line in figure.axes[2].lines[:2]}
    assert len(styles) == 2


def test_a_figure_for_paper_is_a_column_wide_with_letters_of_8_points_and_no_title() -> None:
    figure = draw_fig12(series(), "title", FigureOptions.of("png", "paper"))
    assert figure.get_size_inches()[0] == FigureOptions.COLUMN_IN
    assert figure.get_suptitle() == ""
    texts: list[Any] = figure.findobj(lambda part: hasattr(part, "get_fontsize") and bool(part.get_text()))
    assert len(texts) > 12
    assert min(text.get_fontsize() for text in texts) >= 8.0


@pytest.mark.check("takes 3.3 s")
@pytest.mark.drawn(0.0, "telenano/analysis/")
def test_every_format_is_written_and_the_same_figure_gives_the_same_bytes() -> None:
    options = FigureOptions.of("svg, pdf,png", "screen")
    files = fig12_files(series(), "title", options, "wave, K_f 20 µ, seed 3")
    assert list(files) == ["fig12.svg", "fig12.pdf", "fig12.png"]
    assert files["fig12.png"].startswith(b"\x89PNG")
    assert files["fig12.pdf"].startswith(b"%PDF")
    # text stays text
    assert b"tip-sample distance" in files["fig12.svg"]
    # a figure for a paper has no title: what it was made from is inside of each file
    assert Image.open(io.BytesIO(files["fig12.png"])).info["Description"] == "wave, K_f 20 µ, seed 3"
    assert "wave, K_f 20 µ, seed 3" in files["fig12.svg"].decode()
    assert "wave, K_f 20 µ, seed 3".encode("utf-16-be") in files["fig12.pdf"]
    assert fig12_files(series(), "title", options, "wave, K_f 20 µ, seed 3") == files


def test_unknown_formats_and_styles_are_refused_with_those_that_there_are() -> None:
    with pytest.raises(ConfigError, match="--format gif: is not one of png, pdf, svg"):
        FigureOptions.of("png,gif")
    with pytest.raises(ConfigError, match="--style poster: is not one of screen, paper"):
        FigureOptions.of("png", "poster")
    with pytest.raises(ConfigError, match="at least one"):
        FigureOptions.of(" ,")
    assert FigureOptions.of("png,png").drawn(Figure(), "x").keys() == {"x.png"}

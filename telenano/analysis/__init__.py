"""Analysis of a recording: series, report, verdict of stability, and figures."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.analysis.estimates import denied as denied
    from telenano.analysis.fig12 import SessionSeries as SessionSeries
    from telenano.analysis.figure_style import VERDICT_COLOURS as VERDICT_COLOURS
    from telenano.analysis.figure_style import FigureOptions as FigureOptions
    from telenano.analysis.holds import STRUCK_FORCES as STRUCK_FORCES
    from telenano.analysis.holds import Fact as Fact
    from telenano.analysis.intervals import DEVIATIONS as DEVIATIONS
    from telenano.analysis.intervals import half_width as half_width
    from telenano.analysis.intervals import student as student
    from telenano.analysis.intervals import wilson as wilson
    from telenano.analysis.mean_interval import mean_half_width as mean_half_width
    from telenano.analysis.page import Page as Page
    from telenano.analysis.page import cell_text as cell_text
    from telenano.analysis.page import png_of as png_of
    from telenano.analysis.recorded_session import Session as Session
    from telenano.analysis.session_judge import summary_of as summary_of
    from telenano.analysis.verdict import Kind as Kind
else:
    __getattr__, __dir__ = face(__name__)

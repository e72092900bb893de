"""What a recording shows: series, report, verdict of stability, figures."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.analysis.intervals import wilson as wilson
else:
    __getattr__, __dir__ = face(__name__)

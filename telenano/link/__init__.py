"""Emulation of the network between the sites: models of delay, loss and queues, and the impairment engine."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.link.direction import DirectionEngine as DirectionEngine
    from telenano.link.fate import Direction as Direction
    from telenano.link.fate import Fate as Fate
    from telenano.link.fate import Release as Release
    from telenano.link.models.outages import Outages as Outages
    from telenano.link.random_streams import stream as stream
else:
    __getattr__, __dir__ = face(__name__)

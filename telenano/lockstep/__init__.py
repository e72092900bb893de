"""Closed loop in lockstep: the same steps as the nodes, compiled, without processes."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.lockstep.simulation import simulate_document as simulate_document
    from telenano.lockstep.steering import HandSteps as HandSteps
    from telenano.lockstep.steering import register_hand as register_hand
else:
    __getattr__, __dir__ = face(__name__)

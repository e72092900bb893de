"""Closed loop in lockstep: the same steps as the nodes, compiled, without processes."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.lockstep.across import steering_force_n as steering_force_n
    from telenano.lockstep.link import Schedule as Schedule
    from telenano.lockstep.lockstep import Rig as Rig
    from telenano.lockstep.lockstep import Series as Series
    from telenano.lockstep.lockstep import Trajectory as Trajectory
    from telenano.lockstep.lockstep import time_to_place_s as time_to_place_s
    from telenano.lockstep.simulation import holds_of as holds_of
    from telenano.lockstep.simulation import instrument_params as instrument_params
    from telenano.lockstep.simulation import simulate_document as simulate_document
    from telenano.lockstep.steering import HandSteps as HandSteps
else:
    __getattr__, __dir__ = face(__name__)

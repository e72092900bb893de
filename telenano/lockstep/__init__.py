"""The closed loop in lockstep: the steps of the nodes in one compiled function, without processes."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.lockstep.link import MESSAGE_BYTES as MESSAGE_BYTES
    from telenano.lockstep.link import Schedule as Schedule
    from telenano.lockstep.link import schedule_from as schedule_from
    from telenano.lockstep.lockstep import Rig as Rig
    from telenano.lockstep.steering import HandSteps as HandSteps
    from telenano.lockstep.trajectory import Trajectory as Trajectory
else:
    __getattr__, __dir__ = face(__name__)

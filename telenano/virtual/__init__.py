"""Simulation of a rig: real nodes of both sites on a bus in memory, in virtual time, reproducible by a seed."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.virtual.bus import VirtualBus as VirtualBus
    from telenano.virtual.rig import ARMED_S as ARMED_S
    from telenano.virtual.rig import EPOCH_OFFSET_NS as EPOCH_OFFSET_NS
    from telenano.virtual.rig import LINK_ENDPOINT as LINK_ENDPOINT
    from telenano.virtual.rig import LINK_NODE as LINK_NODE
    from telenano.virtual.rig import NODES as NODES
    from telenano.virtual.rig import STARTED_S as STARTED_S
    from telenano.virtual.rig import VirtualRig as VirtualRig
    from telenano.virtual.rig import record_session as record_session
    from telenano.virtual.timing import RANDOM_TIMING as RANDOM_TIMING
    from telenano.virtual.timing import Range as Range
    from telenano.virtual.timing import Timing as Timing
    from telenano.virtual.timing import constant_timing as constant_timing
else:
    __getattr__, __dir__ = face(__name__)

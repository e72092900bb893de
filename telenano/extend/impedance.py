"""The coupling between a law and a device that takes a force: its settings, its pure step, and what its guard says.

    settings = config.to_settings(capabilities)
    force_n, state = coupling_step(state, settings, reference, reading, dt_s)

A device that takes a force has it in a process of its own; the simulated one, `simulated_impedance`, in the node.
"""

from telenano.hand.coupling import GATE_REST as GATE_REST
from telenano.hand.coupling import ZERO as ZERO
from telenano.hand.coupling import CouplingReading as CouplingReading
from telenano.hand.coupling import CouplingReference as CouplingReference
from telenano.hand.coupling import CouplingSettings as CouplingSettings
from telenano.hand.coupling import Vector as Vector
from telenano.hand.coupling import coupling_at_start as coupling_at_start
from telenano.hand.coupling import coupling_step as coupling_step
from telenano.hand.driver import UPRIGHT as UPRIGHT
from telenano.hand.driver import Quaternion as Quaternion
from telenano.hand.driver import SpatialReading as SpatialReading
from telenano.hand.impedance_config import CouplingConfig as CouplingConfig
from telenano.runtime.loop.log import StructuredLog as StructuredLog
from telenano.settings.config import refused_code as refused_code

"""The hand and its haptic device as steps without a clock: motor, operator, coupling, guard and their settings."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.hand.config import DRIVERS as DRIVERS
    from telenano.hand.config import SIMULATED_IMPEDANCE as SIMULATED_IMPEDANCE
    from telenano.hand.config import HapticConfig as HapticConfig
    from telenano.hand.config import LimitsConfig as LimitsConfig
    from telenano.hand.coupled import arm_step as arm_step
    from telenano.hand.coupling import ZERO as ZERO
    from telenano.hand.coupling import CouplingReading as CouplingReading
    from telenano.hand.coupling import CouplingReference as CouplingReference
    from telenano.hand.coupling import CouplingSettings as CouplingSettings
    from telenano.hand.coupling import Gate as Gate
    from telenano.hand.coupling import Vector as Vector
    from telenano.hand.coupling import coupling_at_start as coupling_at_start
    from telenano.hand.coupling import coupling_step as coupling_step
    from telenano.hand.impedance_config import CouplingConfig as CouplingConfig
    from telenano.hand.impedance_config import bounds_of as bounds_of
    from telenano.hand.motor import MotorParams as MotorParams
    from telenano.hand.motor import MotorState as MotorState
    from telenano.hand.operator_models import operator_at_rest as operator_at_rest
    from telenano.hand.operator_models import operator_step as operator_step
    from telenano.hand.step import initial_plant as initial_plant
    from telenano.hand.step import plant_step as plant_step
else:
    __getattr__, __dir__ = face(__name__)

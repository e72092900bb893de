"""The hand and its haptic device as steps without a clock: motor, operator and guard."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.hand.motor import MotorParams as MotorParams
    from telenano.hand.operator import interpolate as interpolate
    from telenano.hand.operator_models import operator_at_rest as operator_at_rest
    from telenano.hand.operator_models import operator_step as operator_step
    from telenano.hand.part import HandPart as HandPart
    from telenano.hand.part import initial_plant as initial_plant
else:
    __getattr__, __dir__ = face(
        __name__,
        {
            "telenano.sections": ("ARMS", "HapticConfig", "LateralPath", "LimitsConfig"),
        },
    )

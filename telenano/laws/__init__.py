"""Teleoperation laws as two-ports: their steps, the timing of both halves, the force clamp, and the lateral path.

Their settings and the table of laws are in `telenano.sections`.
"""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.laws.virtual_impedance import ImpedanceState as ImpedanceState
    from telenano.laws.virtual_impedance import VirtualImpedanceParams as VirtualImpedanceParams
else:
    __getattr__, __dir__ = face(
        __name__,
        {
            "telenano.sections": ("ControllerConfig", "LAWS", "OWN_LAWS", "changed_config", "late_periods"),
        },
    )

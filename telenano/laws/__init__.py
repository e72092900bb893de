"""Teleoperation laws as two-ports: their steps, the timing of both halves, the force clamp, and the lateral path.

Their settings and the table of laws are in `telenano.sections`.
"""

from telenano.lazy_exports import face

__getattr__, __dir__ = face(
    __name__,
    {
        "telenano.sections": ("ControllerConfig", "LAWS", "OWN_LAWS", "changed_config", "late_periods"),
    },
)

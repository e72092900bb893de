"""Teleoperation laws as two-ports: their steps, the timing of both halves, force clamp, x and y, and settings."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.laws.config import LAWS as LAWS
    from telenano.laws.config import OWN_LAWS as OWN_LAWS
    from telenano.laws.config import ControllerConfig as ControllerConfig
    from telenano.laws.config import changed_config as changed_config
    from telenano.laws.config import late_periods as late_periods
else:
    __getattr__, __dir__ = face(__name__)

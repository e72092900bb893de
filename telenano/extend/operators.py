"""A simulated hand of one's own: settings, and a pure step from motion of the arm to force on it."""

from services.haptic_node.physics.operator import OperatorInputs, OperatorOutputs
from services.haptic_node.physics.operator_models import OperatorModel
from services.numerics.compiled import compiled
from services.runtime.settings.config import Settings

__all__ = ["OperatorInputs", "OperatorModel", "OperatorOutputs", "Settings", "compiled"]

"""A simulated hand of one's own: settings, and a pure step from motion of the arm to force on it."""

from services.haptic_node.physics.operator import OperatorInputs as OperatorInputs
from services.haptic_node.physics.operator import OperatorOutputs as OperatorOutputs
from services.haptic_node.physics.operator_models import OperatorModel as OperatorModel
from services.numerics.compiled import compiled as compiled
from services.runtime.settings.config import Settings as Settings

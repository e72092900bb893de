"""A simulated hand of one's own: settings, and a pure step from motion of the arm to force on it."""

from telenano.hand.operator import OperatorInputs as OperatorInputs
from telenano.hand.operator import OperatorOutputs as OperatorOutputs
from telenano.hand.operator_models import OperatorModel as OperatorModel

"""An emulated device that takes a force: an arm under a force, a simulated hand on it, and what its guard says."""

from pathlib import Path
from typing import Any

from telenano.cli import section_of
from telenano.hand.config import HapticConfig
from telenano.hand.coupled import arm_step as arm_step
from telenano.hand.coupling import GATE_ACTIVE as GATE_ACTIVE
from telenano.hand.coupling import GATE_DEADMAN as GATE_DEADMAN
from telenano.hand.coupling import GATE_DEVICE_SILENT as GATE_DEVICE_SILENT
from telenano.hand.coupling import GATE_FROZEN as GATE_FROZEN
from telenano.hand.coupling import GATE_JUMP as GATE_JUMP
from telenano.hand.coupling import GATE_NOT_A_NUMBER as GATE_NOT_A_NUMBER
from telenano.hand.coupling import GATE_READY as GATE_READY
from telenano.hand.coupling import GATE_RELEASED as GATE_RELEASED
from telenano.hand.coupling import GATE_RUNAWAY as GATE_RUNAWAY
from telenano.hand.coupling import GATE_SILENT as GATE_SILENT
from telenano.hand.coupling import GATES as GATES
from telenano.hand.operator import OperatorInputs as OperatorInputs
from telenano.hand.operator_models import operator_at_rest as operator_at_rest
from telenano.hand.operator_models import operator_step as operator_step


def hand_of(scenario: Path | None = None) -> Any:
    """Return the simulated hand of a scenario that is named or a file, or the default one, for `operator_step`.

    Raises:
        ConfigError: There is no such scenario, or a key of it cannot be read.
    """
    return section_of(scenario, "haptic_node", HapticConfig).operator.to_params()

"""An emulated device that takes a force, and what tries its driver: hands, and a servo in virtual time."""

from pathlib import Path
from typing import Any, NamedTuple

from telenano.cli import section_of
from telenano.devices.hand.servo_process import ProcessLink as ProcessLink
from telenano.devices.hand.servo_process import ServoLoop as ServoLoop
from telenano.devices.hand.servo_process import SharedServo as SharedServo
from telenano.extend.impedance import ZERO, Vector
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
from telenano.hand.coupling import GATE_REST as GATE_REST
from telenano.hand.coupling import GATE_RUNAWAY as GATE_RUNAWAY
from telenano.hand.coupling import GATE_SILENT as GATE_SILENT
from telenano.hand.coupling import GATES as GATES
from telenano.hand.coupling import CouplingSettings as CouplingSettings
from telenano.hand.impedance_config import CouplingConfig as CouplingConfig
from telenano.hand.operator import OperatorInputs as OperatorInputs
from telenano.hand.operator_models import operator_at_rest as operator_at_rest
from telenano.hand.operator_models import operator_step as operator_step
from telenano.hand.servo import ServoCommand as ServoCommand
from telenano.hand.servo import ServoSample as ServoSample


class HandMotion(NamedTuple):
    """What the hand does at a time [s]: where it means to be, its spring and damper, a force besides, and buttons."""

    place_m: Vector = ZERO
    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    force_n: Vector = ZERO
    buttons: int = 0
    plugged: bool = True


def hand_of(scenario: Path | None = None) -> Any:
    """Return the simulated hand of a scenario that is named or a file, or the default one, for `operator_step`.

    Raises:
        ConfigError: There is no such scenario, or a key of it cannot be read.
    """
    return section_of(scenario, "haptic_node", HapticConfig).operator.to_params()

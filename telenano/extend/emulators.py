"""An emulated device that takes a force, and what tries its driver: hands, and a servo in virtual time."""

from pathlib import Path
from typing import Any, NamedTuple

from services.haptic_node.config import HapticConfig
from services.haptic_node.coupling import (
    GATE_ACTIVE,
    GATE_DEADMAN,
    GATE_DEVICE_SILENT,
    GATE_FROZEN,
    GATE_JUMP,
    GATE_NOT_A_NUMBER,
    GATE_READY,
    GATE_RELEASED,
    GATE_REST,
    GATE_RUNAWAY,
    GATE_SILENT,
    GATES,
    CouplingSettings,
)
from services.haptic_node.devices.firmware import compiled as compile_library
from services.haptic_node.devices.servo_process import ProcessLink, ServoLoop, SharedServo
from services.haptic_node.impedance_config import CouplingConfig
from services.haptic_node.physics.coupled import arm_step
from services.haptic_node.physics.operator import OperatorInputs
from services.haptic_node.physics.operator_models import operator_at_rest, operator_step
from services.haptic_node.servo import ServoCommand, ServoSample
from telenano.extend.commands import section_of
from telenano.extend.impedance import ZERO, Vector

__all__ = [
    "GATES",
    "GATE_ACTIVE",
    "GATE_DEADMAN",
    "GATE_DEVICE_SILENT",
    "GATE_FROZEN",
    "GATE_JUMP",
    "GATE_NOT_A_NUMBER",
    "GATE_READY",
    "GATE_RELEASED",
    "GATE_REST",
    "GATE_RUNAWAY",
    "GATE_SILENT",
    "CouplingConfig",
    "CouplingSettings",
    "HandMotion",
    "OperatorInputs",
    "ProcessLink",
    "ServoCommand",
    "ServoLoop",
    "ServoSample",
    "SharedServo",
    "arm_step",
    "compile_library",
    "hand_of",
    "operator_at_rest",
    "operator_step",
]


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

"""An emulated device that takes a force, and what tries its driver: hands, a servo in virtual time, acceptance."""

from pathlib import Path
from typing import Any

from services.haptic_node.acceptance.checks import verdicts_of
from services.haptic_node.acceptance.simulated_person import person, reach_of
from services.haptic_node.acceptance.take import Take, record_take, steps_of
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
from services.haptic_node.physics.hand_motion import HandMotion
from services.haptic_node.physics.operator import OperatorInputs
from services.haptic_node.physics.operator_models import operator_at_rest, operator_step
from services.haptic_node.servo import ServoCommand, ServoSample
from services.numerics.acceptance import Verdict, overall
from telenano.extend.commands import section_of

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
    "Take",
    "Verdict",
    "arm_step",
    "compile_library",
    "hand_of",
    "operator_at_rest",
    "operator_step",
    "overall",
    "person",
    "reach_of",
    "record_take",
    "steps_of",
    "verdicts_of",
]


def hand_of(scenario: Path | None = None) -> Any:
    """Return the simulated hand of a scenario that is named or a file, or the default one, for `operator_step`.

    Raises:
        ConfigError: There is no such scenario, or a key of it cannot be read.
    """
    return section_of(scenario, "haptic_node", HapticConfig).operator.to_params()

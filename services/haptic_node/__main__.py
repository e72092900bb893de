"""Program of the haptic node, with the device that its configuration names."""

import gc

if __name__ == "__main__":
    # The imports create no garbage, and searching for it would take an eighth of their time.
    gc.disable()

import sys
from pathlib import Path

from services.haptic_node.node import INPUTS, HapticNode
from telenano.extend.hands import HapticDevice
from telenano.runtime.loop.node import LOOP_PERIOD_S, NodeContext
from telenano.runtime.wiring.main import NodeKind, ordinary, run_node
from telenano.sections.hand_section import DRIVERS, HapticConfig


def build(context: NodeContext, config: HapticConfig) -> HapticNode:
    """Return the node with its device, which it opens."""
    return HapticNode(context, config, device_of(config, context.period_s))


def device_of(config: HapticConfig, period_s: float = LOOP_PERIOD_S) -> HapticDevice:
    """Return the driver that a configuration names, not yet opened."""
    if config.in_lockstep:
        return config.to_simulated_device()
    if (driver := DRIVERS.find(config.driver)) is not None:
        device: HapticDevice = driver.device(config, config.limits, period_s)
        return device
    assert config.serial is not None
    from telenano.devices.hand.calibration import HandleCalibration
    from telenano.devices.hand.serial_driver import SerialHandle

    calibration = HandleCalibration.from_file(Path(config.serial.calibration))
    return SerialHandle(config.serial.port, config.serial.baud, calibration, config.limits, period_s=period_s)


HAPTIC_NODE = NodeKind("haptic_node", HapticConfig, ordinary(build, INPUTS))

if __name__ == "__main__":
    sys.exit(run_node(HAPTIC_NODE))

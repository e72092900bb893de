"""The drivers of this package, which telenano finds by its entry points; a wire is imported in the servo's process."""

from pathlib import Path

from telenano.extend.hands import HapticDevice
from telenano.hand import LimitsConfig
from telenano.settings import DeviceDriver
from telenano_haptic_devices.impedance import impedance_driver
from telenano_haptic_devices.serial_handle.settings import SerialConfig
from telenano_haptic_devices.settings import DhdConfig, HaplyConfig, HdConfig

HAPLY = impedance_driver(
    "haply", HaplyConfig, "telenano_haptic_devices.haply:HaplyWire", "Haply Inverse3", experimental=True
)
DHD = impedance_driver(
    "dhd", DhdConfig, "telenano_haptic_devices.dhd:DhdWire", "Force Dimension, Novint Falcon", experimental=True
)
HD = impedance_driver("hd", HdConfig, "telenano_haptic_devices.hd:HdWire", "3D Systems Touch", experimental=True)


def _serial(settings: SerialConfig, limits: LimitsConfig, *, period_s: float) -> HapticDevice:
    from telenano_haptic_devices.serial_handle.calibration import read_handle_calibration
    from telenano_haptic_devices.serial_handle.serial_driver import SerialHandle

    calibration = read_handle_calibration(Path(settings.calibration))
    return SerialHandle(settings.port, settings.baud, calibration, limits, period_s=period_s)


SERIAL = DeviceDriver(
    "haptic_node",
    "serial",
    SerialConfig,
    _serial,
    told=("period_s",),
    what="a handle on a serial port",
    experimental=True,
)

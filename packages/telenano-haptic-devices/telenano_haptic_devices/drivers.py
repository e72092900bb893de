"""The drivers of this package, which telenano finds by its entry points; a wire is imported in the servo's process."""

from telenano_haptic_devices.impedance import impedance_driver
from telenano_haptic_devices.settings import DhdConfig, HaplyConfig, HdConfig

HAPLY = impedance_driver(
    "haply", HaplyConfig, "telenano_haptic_devices.haply:HaplyWire", "Haply Inverse3", experimental=True
)
DHD = impedance_driver(
    "dhd", DhdConfig, "telenano_haptic_devices.dhd:DhdWire", "Force Dimension, Novint Falcon", experimental=True
)
HD = impedance_driver("hd", HdConfig, "telenano_haptic_devices.hd:HdWire", "3D Systems Touch", experimental=True)

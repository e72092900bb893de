"""The drivers of this package, which telenano finds by its entry points; a wire is imported in the servo's process."""

from telenano_haptic_devices.impedance import impedance_driver
from telenano_haptic_devices.impedance_wire import ImpedanceWire
from telenano_haptic_devices.settings import DhdConfig, HaplyConfig, HdConfig


def _haply(settings: HaplyConfig) -> ImpedanceWire:
    from telenano_haptic_devices.haply import HaplyWire

    return HaplyWire(settings)


def _dhd(settings: DhdConfig) -> ImpedanceWire:
    from telenano_haptic_devices.dhd import DhdWire

    return DhdWire(settings)


def _hd(settings: HdConfig) -> ImpedanceWire:
    from telenano_haptic_devices.hd import HdWire

    return HdWire(settings)


HAPLY = impedance_driver("haply", HaplyConfig, _haply, "Haply Inverse3")
DHD = impedance_driver("dhd", DhdConfig, _dhd, "Force Dimension, Novint Falcon")
HD = impedance_driver("hd", HdConfig, _hd, "3D Systems Touch")

"""Force devices for telenano: Haply's Inverse3, those of Force Dimension, 3D Systems' Touch, and one of your own.

    from telenano_devices.impedance import impedance_driver

    MY_DEVICE = impedance_driver("my_device", MyConfig, "my_package.wire:MyWire", "the device, for a list")

The names of this module are imported when they are first used, because the node needs only the declaration of a driver,
and the process of the servo only its wire.
"""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano_devices.impedance.impedance import impedance_driver as impedance_driver
    from telenano_devices.impedance.impedance_wire import ImpedanceWire as ImpedanceWire
    from telenano_devices.impedance.impedance_wire import Turn as Turn
    from telenano_devices.impedance.impedance_wire import quaternion_of as quaternion_of
    from telenano_devices.impedance.servo import DeviceSample as DeviceSample
    from telenano_devices.impedance.vendor_library import LibraryWire as LibraryWire
    from telenano_devices.impedance.vendor_library import VendorLibrary as VendorLibrary
    from telenano_devices.impedance.vendor_service import Conversation as Conversation
    from telenano_devices.impedance.vendor_service import Exchange as Exchange
    from telenano_devices.impedance.vendor_service import VendorService as VendorService
    from telenano_devices.impedance.wires import Cadence as Cadence
    from telenano_devices.impedance.wires import Declared as Declared
    from telenano_devices.impedance.wires import Frame as Frame
    from telenano_devices.impedance.wires import declared as declared
else:
    __getattr__, __dir__ = face(__name__)

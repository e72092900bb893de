"""Drivers of real devices, with their lines, processes, calibrations and capabilities."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.devices.afm.capabilities import AfmCapabilities as AfmCapabilities
    from telenano.devices.afm.converter_calibration import CantileverCalibration as CantileverCalibration
    from telenano.devices.afm.converter_calibration import InstrumentCalibration as InstrumentCalibration
    from telenano.devices.afm.converter_calibration import Readings as Readings
    from telenano.devices.afm.instrument import driver_of as driver_of
    from telenano.devices.afm.modbus_driver import ModbusAfm as ModbusAfm
    from telenano.devices.afm.modbus_frames import FeedbackRequest as FeedbackRequest
    from telenano.devices.afm.modbus_line import Line as Line
    from telenano.devices.afm.register_map import read_map as read_map
    from telenano.devices.afm.tcp_driver import TcpDriver as TcpDriver
    from telenano.devices.afm.virtual_instrument import VirtualInstrument as VirtualInstrument
    from telenano.devices.hand.calibration import HandleCalibration as HandleCalibration
    from telenano.devices.hand.serial_driver import SerialHandle as SerialHandle
    from telenano.devices.hand.wire import HandleAbility as HandleAbility
    from telenano.devices.hand.wire import HandleFlag as HandleFlag
else:
    __getattr__, __dir__ = face(__name__)

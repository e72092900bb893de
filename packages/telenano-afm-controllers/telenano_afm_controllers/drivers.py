"""What telenano finds of this package: its drivers, which it imports when a scenario names one."""

from pathlib import Path
from typing import Any

from telenano.devices import AfmCapabilities
from telenano.extend.instruments import AfmDriver, SafetyParams
from telenano.settings import DeviceDriver
from telenano_afm_controllers.calibration import GwyscopeCalibration, NanonisCalibration
from telenano_afm_controllers.controller_settings import ControllerSettings, ModbusSettings
from telenano_afm_controllers.converter_calibration import (
    InstrumentCalibration,
    read_controller,
    read_stage_calibration,
)
from telenano_afm_controllers.register_map import read_map


def _gwyscope(settings: ControllerSettings, limits: SafetyParams, **told: Any) -> AfmDriver:
    from telenano_afm_controllers.gwyscope_driver import GwyscopeAfm

    found = read_controller(Path(settings.calibration), GwyscopeCalibration)
    return GwyscopeAfm(found.reached_at(settings.host, settings.port), limits, **told)


def _nanonis(settings: ControllerSettings, limits: SafetyParams, **told: Any) -> AfmDriver:
    from telenano_afm_controllers.nanonis_driver import NanonisAfm

    found = read_controller(Path(settings.calibration), NanonisCalibration)
    return NanonisAfm(found.reached_at(settings.host, settings.port), limits, **told)


def _modbus(settings: ModbusSettings, limits: SafetyParams, *, period_s: float) -> AfmDriver:
    from telenano_afm_controllers.modbus_driver import ModbusAfm

    calibration = read_stage_calibration(Path(settings.calibration))
    own = {"host": settings.host, "port": settings.port}
    network = calibration.network.model_copy(update={key: value for key, value in own.items() if value is not None})
    calibration = calibration.model_copy(update={"network": network})
    return ModbusAfm(calibration, read_map(calibration.instrument.map), limits, period_s=period_s)


MODBUS = DeviceDriver(
    "afm_node",
    "modbus",
    ModbusSettings,
    _modbus,
    told=("period_s",),
    capabilities=AfmCapabilities(
        500.0, 500.0, 2.5e-3, False, False, True, ("deflection",), "a script on a T7; a watchdog of 1 s elsewhere"
    ),
    calibration=InstrumentCalibration,
    experimental=True,
)
GWYSCOPE = DeviceDriver(
    "afm_node",
    "gwyscope",
    ControllerSettings,
    _gwyscope,
    told=("period_s", "attended"),
    capabilities=AfmCapabilities(
        500.0, 333.0, 4e-3, True, True, True, ("e", "adc1", "adc2", "in1 to in16"), "the guard, or a person"
    ),
    calibration=GwyscopeCalibration,
    experimental=True,
)
NANONIS = DeviceDriver(
    "afm_node",
    "nanonis",
    ControllerSettings,
    _nanonis,
    told=("period_s", "attended"),
    # These figures hold for a Tap of 20 ms. The samples of a TCP Logger are newer, and z stays as slow.
    capabilities=AfmCapabilities(
        400.0,
        50.0,
        22.5e-3,
        True,
        False,
        False,
        ("any signal, by its name",),
        "the guard, or a person; its safe tip",
        scans=True,
    ),
    calibration=NanonisCalibration,
    experimental=True,
)

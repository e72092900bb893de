"""Declares the driver of a Gwyscope, which telenano imports when a scenario names it."""

from pathlib import Path
from typing import Any

from telenano.devices import AfmCapabilities
from telenano.extend.instruments import AfmDriver, SafetyParams
from telenano.sections import AfmControllerConfig as ControllerSettings
from telenano.settings import DeviceDriver
from telenano_devices.gwyscope.gwyscope_calibration import GwyscopeCalibration


def _gwyscope(settings: ControllerSettings, limits: SafetyParams, **keywords: Any) -> AfmDriver:
    from telenano_devices.gwyscope.gwyscope_driver import GwyscopeAfm

    controller = GwyscopeCalibration.from_file(Path(settings.calibration))
    return GwyscopeAfm(controller.reached_at(settings.host, settings.port), limits, **keywords)


GWYSCOPE = DeviceDriver(
    "afm_node",
    "gwyscope",
    ControllerSettings,
    _gwyscope,
    keywords=("period_s", "attended"),
    capabilities=AfmCapabilities(
        500.0, 333.0, 4e-3, True, True, True, ("e", "adc1", "adc2", "in1 to in16"), "the guard, or a person"
    ),
    calibration=GwyscopeCalibration,
    experimental=True,
)

"""What telenano finds of this package: the drivers of both controllers, which it imports when a scenario names one."""

from pathlib import Path
from typing import Any

from telenano.afm import AfmControllerConfig as ControllerSettings
from telenano.devices import AfmCapabilities
from telenano.extend.instruments import AfmDriver, SafetyParams
from telenano.settings import DeviceDriver
from telenano_afm_controllers.calibration import GwyscopeCalibration, NanonisCalibration


def _gwyscope(settings: ControllerSettings, limits: SafetyParams, **keywords: Any) -> AfmDriver:
    from telenano_afm_controllers.gwyscope_driver import GwyscopeAfm

    controller = GwyscopeCalibration.from_file(Path(settings.calibration))
    return GwyscopeAfm(controller.reached_at(settings.host, settings.port), limits, **keywords)


def _nanonis(settings: ControllerSettings, limits: SafetyParams, **keywords: Any) -> AfmDriver:
    from telenano_afm_controllers.nanonis_driver import NanonisAfm

    controller = NanonisCalibration.from_file(Path(settings.calibration))
    return NanonisAfm(controller.reached_at(settings.host, settings.port), limits, **keywords)


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
NANONIS = DeviceDriver(
    "afm_node",
    "nanonis",
    ControllerSettings,
    _nanonis,
    keywords=("period_s", "attended"),
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

"""Declares the driver of a Nanonis controller, which telenano imports when a scenario names it."""

from pathlib import Path
from typing import Any

from telenano.devices import AfmCapabilities
from telenano.extend.instruments import AfmDriver, SafetyParams
from telenano.sections import AfmControllerConfig as ControllerSettings
from telenano.settings import DeviceDriver
from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration


def _nanonis(settings: ControllerSettings, limits: SafetyParams, **keywords: Any) -> AfmDriver:
    from telenano_devices.nanonis.nanonis_driver import NanonisAfm

    controller = NanonisCalibration.from_file(Path(settings.calibration))
    return NanonisAfm(controller.reached_at(settings.host, settings.port), limits, **keywords)


NANONIS = DeviceDriver(
    "afm_node",
    "nanonis",
    ControllerSettings,
    _nanonis,
    keywords=("period_s", "attended"),
    # These figures hold for a Tap of 20 ms. With a TCP Logger the samples are newer, but z is as slow.
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

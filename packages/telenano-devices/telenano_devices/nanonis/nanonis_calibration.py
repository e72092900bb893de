"""The calibration file `nanonis.yaml`."""

from typing import Literal

from pydantic import Field

from telenano_devices.controllers.piezo_calibration import ControllerCalibration


class NanonisCalibration(ControllerCalibration):
    """A calibration file of a Nanonis controller."""

    controller: Literal["nanonis"]
    safe_tip: float = Field(
        gt=0.0,
        le=1e6,
        description="Threshold of the controller's own safe tip, in the unit of its signal: nothing else withdraws "
        "the tip without this rig",
    )
    tip_lift_m: float = Field(
        0.0, ge=0.0, le=1e-6, description="Distance by which it lifts the tip when its z-controller is switched off [m]"
    )
    logger_port: int | None = Field(
        None, ge=1, le=65535, description="Port of its TCP Logger, if that module runs; none: values are polled"
    )

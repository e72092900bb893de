"""The calibration files `gwyscope.yaml` and `nanonis.yaml`."""

from typing import Literal

from pydantic import Field, model_validator

from telenano_afm_controllers.piezo_calibration import ControllerCalibration


class GwyscopeCalibration(ControllerCalibration):
    """A calibration file of a Gwyscope."""

    controller: Literal["gwyscope"]

    @model_validator(mode="after")
    def _retracts_when_it_ends(self) -> "GwyscopeCalibration":
        if self.z.retract_m != 0.0 and not self.z.unsafe_wiring_acknowledged:
            raise ValueError(
                f"z.retract_m = {self.z.retract_m} m: a server that ends puts z to 0 m and would not retract; wire it"
                " so that 0 m is retracted, or set z.unsafe_wiring_acknowledged: true"
            )
        if self.channels:
            raise ValueError("channels: the driver of a Gwyscope reads the deflection only")
        return self


class NanonisCalibration(ControllerCalibration):
    """A calibration file of a Nanonis controller."""

    controller: Literal["nanonis"]
    safe_tip: float = Field(
        gt=0.0,
        le=1e6,
        description="Value of its own safe tip, in the unit of its signal: nothing else withdraws the tip without this"
        " rig",
    )
    tip_lift_m: float = Field(
        0.0, ge=0.0, le=1e-6, description="How far it lifts the tip when its z-controller is switched off [m]"
    )
    logger_port: int | None = Field(
        None, ge=1, le=65535, description="Port of its TCP Logger, where its module runs; none: values are polled"
    )

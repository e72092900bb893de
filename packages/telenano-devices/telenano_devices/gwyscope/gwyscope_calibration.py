"""The calibration file `gwyscope.yaml`."""

from typing import Literal

from pydantic import model_validator

from telenano_devices.controllers.piezo_calibration import ControllerCalibration


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

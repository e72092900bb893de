"""Settings of a real instrument in a scenario: its calibration file, and where it is reached."""

from pydantic import Field

from telenano.settings import Settings


class ModbusSettings(Settings):
    """A stage and a deflection behind a Modbus instrument."""

    calibration: str = Field(min_length=1, description="Calibration file of this very device (stage.yaml)")
    host: str | None = Field(None, min_length=1, max_length=255, description="In place of the calibration's host")
    port: int | None = Field(None, ge=1, le=65535, description="In place of the calibration's port")


class ControllerSettings(Settings):
    """The controller of an AFM, or the guard in front of it."""

    calibration: str = Field(min_length=1, description="Calibration file of this very controller")
    host: str | None = Field(None, min_length=1, max_length=255, description="In place of the calibration's host")
    port: int | None = Field(None, ge=1, le=65535, description="In place of the calibration's port")

"""Settings of the handle in a scenario."""

from pydantic import Field

from telenano.settings import Settings


class SerialConfig(Settings):
    """A handle on a serial port, in handle protocol 1."""

    port: str = Field(
        min_length=1, description="Device file, best one of /dev/serial/by-id, whose name stays when it is plugged in"
    )
    baud: int = Field(1_000_000, ge=115_200, le=12_000_000, description="Bits a second; without effect on native USB")
    calibration: str = Field(min_length=1, description="Calibration file of this very device (handle.yaml)")

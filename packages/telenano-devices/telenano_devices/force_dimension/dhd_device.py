"""Declares the driver of Force Dimension's devices and its settings; only the servo's process imports its wire."""

from pydantic import Field

from telenano.settings import Settings
from telenano_devices.impedance.impedance import impedance_driver


class DhdConfig(Settings):
    """Section `haptic_node.dhd`: omega, delta, sigma, lambda and Falcon, by Force Dimension's libdhd."""

    library: str | None = Field(
        default=None, description="File of libdhd or libdrd, with `--allow-code`; none: it is looked for"
    )
    serial: int | None = Field(default=None, ge=0, le=65_535, description="Serial number; none: the first free device")
    rate_hz: float = Field(default=1000.0, ge=100.0, le=4000.0, description="Rate of the servo [Hz]; [100, 4000]")
    deadman_button: int | None = Field(
        default=None, ge=0, le=31, description="Number of the button that has to be held for any force; none: no button"
    )


DHD = impedance_driver(
    "dhd",
    DhdConfig,
    "telenano_devices.force_dimension.dhd:DhdWire",
    "Force Dimension, Novint Falcon",
    experimental=True,
)

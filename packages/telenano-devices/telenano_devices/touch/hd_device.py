"""Declares the driver of 3D Systems' Touch and its settings; only the servo's process imports its wire."""

from typing import Literal

from pydantic import Field

from telenano.settings import Settings
from telenano_devices.impedance.impedance import impedance_driver


class HdConfig(Settings):
    """Section `haptic_node.hd`: 3D Systems Touch, by OpenHaptics' libHD."""

    library: str | None = Field(default=None, description="File of libHD, with `--allow-code`; none: it is looked for")
    name: str | None = Field(default=None, description="Name of the device in its driver; none: the default one")
    rate_hz: Literal[500, 1000] = Field(default=1000, description="Rate of the scheduler [Hz]: 500 or 1000")
    deadman_button: int | None = Field(
        default=None, ge=0, le=3, description="Number of the button that has to be held for any force; none: no button"
    )


HD = impedance_driver("hd", HdConfig, "telenano_devices.touch.hd:HdWire", "3D Systems Touch", experimental=True)

"""Declares the driver of Haply's Inverse3 and its settings; only the servo's process imports its wire."""

from typing import Literal

from pydantic import Field

from telenano.settings import Settings
from telenano_devices.impedance.impedance import impedance_driver


class HaplyConfig(Settings):
    """Section `haptic_node.haply`: Haply Inverse3 with a VerseGrip, by the Inverse Service."""

    service: str = Field(
        default="ws://127.0.0.1:10001", description="Address of the Inverse Service, whose port can be changed there"
    )
    device_id: str | None = Field(default=None, description="Id of the Inverse3; none: the only one that there is")
    rate_hz: float = Field(
        default=1000.0, ge=100.0, le=4000.0, description="Rate at which the service is asked [Hz]; [100, 4000]"
    )
    force_field: Literal["vector", "values"] = Field(
        default="vector", description="Key of the force: vector as in the pages of 3.x, values as in most public code"
    )
    force_gate: float | None = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Gain of the service's force gate; 0 for none; none: as the service has it",
    )
    damping: float | None = Field(
        default=0.0,
        ge=0.0,
        le=100.0,
        description="Scalar of the service's damper; 0 for none; none: as the service has it",
    )
    preset: Literal["arm_front_centered", "led_front_centered"] = Field(
        default="arm_front_centered", description="Orientation of the device; zero is the centre of its workspace"
    )
    deadman: Literal["", "a", "b", "c"] = Field(
        default="", description="Button of the grip that has to be held for any force; empty: none"
    )


HAPLY = impedance_driver(
    "haply", HaplyConfig, "telenano_devices.haply.haply:HaplyWire", "Haply Inverse3", experimental=True
)

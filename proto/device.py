"""What the state of a device says of a real one; a simulated one is sampled in the moment of its message."""

from typing import Any, Literal

from pydantic import Field

DeviceStatus = Literal["ok", "stale", "lost"]

DEVICE: Any = Field(
    default=None,
    description="State of a real device: stale repeats its last sample, lost is not driven. Absent if simulated",
)
SAMPLE_AGE_S: Any = Field(
    default=None, description="Age of the sample of a real device when published [s]; absent if simulated"
)

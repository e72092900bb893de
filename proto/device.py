"""What the state of a device says of a real one; a simulated one is sampled in the moment of its message."""

from typing import Any, Literal

from pydantic import Field

DeviceStatus = Literal["ok", "stale", "lost"]

DEVICE: Any = Field(
    default=None,
    description="State of a real device: stale repeats its last sample, lost is not driven. Absent if simulated",
)
LATENCY_S: Any = Field(
    default=None,
    description="What a real device is declared to add to the round trip [s]: from a command to the sample that answers"
    " it, in the mean; absent if simulated",
)
MEAN_AGE_S: Any = Field(
    default=None,
    description="Mean age of the samples of a real device since the last report [s]; absent if there were none",
)
SAMPLE_AGE_S: Any = Field(
    default=None, description="Age of the sample of a real device when published [s]; absent if simulated"
)

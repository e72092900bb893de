"""The range of every quantity on the wire, declared once, with the most extreme physical case that needs it.

Readers reject values beyond a range, so that their arithmetic stays finite. A range lies far above anything that can be
measured and is no limit of an instrument: those belong to the guard of each device.
"""

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta


@dataclass(frozen=True)
class Range:
    """Inclusive bounds of a quantity, their unit, and the case that needs them."""

    quantity: str
    low: float
    high: float
    unit: str
    reason: str

    def of_value(self) -> Meta:
        """Return the msgspec rule for a number within the bounds; it rejects NaN."""
        return Meta(ge=self.low, le=self.high, extra={"range": self})

    def of_elements(self) -> Meta:
        """Return the rule for an array with all elements within the bounds, which `telenano.wire.codec` checks."""
        return Meta(extra={"elements": self})

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g} {self.unit}".rstrip()


POSITION = Range(
    "position", -10.0, 10.0, "m", "ten times the travel of 1 m that a haptic device may be given; an AFM moves 0.1 mm"
)
WAY = Range(
    "position at the slave's scale",
    -1e6,
    1e6,
    "m",
    "the counter of waves, which grows with the impulse: 10 N on a line of 1 N s/m for a day are 8.6e5 m",
)
VELOCITY = Range("velocity", -1e3, 1e3, "m/s", "a hundred times the fastest reference that a device may be given")
FORCE = Range(
    "force",
    -1e6,
    1e6,
    "N",
    "a motor of 10 N m through a screw of 2.8e-5 m/rad: 3.6e5 N; the stiffest spring on a base: 1e9 N/m over 0.2 mm",
)
WAVE = Range("wave variable", -1e6, 1e6, "sqrt(W)", "1 kN on a line of 1 mN s/m are 2.2e4 sqrt(W)")
ENERGY = Range("energy", -1e12, 1e12, "J", "1 kW at a port for thirty years")
POWER = Range("power", -1e9, 1e9, "W", "the greatest force at the greatest velocity")
DURATION = Range("duration", 0.0, 1e10, "s", "2^63 ns are 9.2e9 s: the most between two time stamps")
TIME = Range("time", -1e10, 1e10, "s", "the same, before or after")
RATE = Range("rate", 0.0, 1e9, "Hz", "one step in each nanosecond of the clock")
PERCENTAGE = Range("percentage", 0.0, 1e6, "%", "ten thousand processors that work for one process")
ANGLE = Range("angle", -1e6, 1e6, "rad", "an unwrapped phase of 1.6e5 turns")
VOLTAGE = Range("voltage", -1e4, 1e4, "V", "ten times the highest voltage that drives a piezo")
QUATERNION = Range("component of a unit quaternion", -1.0, 1.0, "", "that of a rotation by no angle at all")
CHANNEL = Range(
    "measured channel", -1e9, 1e9, "its SI unit", "the greatest rate, as of a frequency shift; others are less"
)

# Every range of this module, for the table of SPEC.md.
RANGES = tuple(value for value in tuple(globals().values()) if isinstance(value, Range))

PositionM = Annotated[float, POSITION.of_value()]
WayM = Annotated[float, WAY.of_value()]
VelocityMPerS = Annotated[float, VELOCITY.of_value()]
ForceN = Annotated[float, FORCE.of_value()]
WaveSqrtW = Annotated[float, WAVE.of_value()]
EnergyJ = Annotated[float, ENERGY.of_value()]
PowerW = Annotated[float, POWER.of_value()]
DurationS = Annotated[float, DURATION.of_value()]
TimeS = Annotated[float, TIME.of_value()]
RateHz = Annotated[float, RATE.of_value()]
Percent = Annotated[float, PERCENTAGE.of_value()]
VoltageV = Annotated[float, VOLTAGE.of_value()]
QuaternionPart = Annotated[float, QUATERNION.of_value()]
ChannelValue = Annotated[float, CHANNEL.of_value()]

PositionVector = tuple[PositionM, PositionM, PositionM]
WayVector = tuple[WayM, WayM, WayM]
VelocityVector = tuple[VelocityMPerS, VelocityMPerS, VelocityMPerS]
ForceVector = tuple[ForceN, ForceN, ForceN]
WaveVector = tuple[WaveSqrtW, WaveSqrtW, WaveSqrtW]

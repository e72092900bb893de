"""Keys that are there only where they apply: what only a real device has to say, and what not every read-out has."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from telenano.wire.ranges import ChannelValue, EnergyJ, QuaternionPart, VoltageV

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
CALIBRATION: Any = Field(
    default=None,
    max_length=128,
    description="Device and date of the calibration that is in use; absent if simulated",
)

RawCount = Annotated[int, Field(ge=-(2**31), lt=2**31)]


class HandCounts(BaseModel):
    """What a real handle sent, before any calibration: a better one reads it again."""

    position_raw: RawCount | None = Field(default=None, description="Position as the handle sent it [counts]")
    velocity_raw: RawCount | None = Field(default=None, description="Velocity as the handle sent it [counts/s]")
    operator_force_raw: RawCount | None = Field(default=None, description="Operator's force as it was sent [counts]")
    drive_raw: RawCount | None = Field(default=None, description="Drive after every limit as it was sent [counts]")


class CoupledHand(BaseModel):
    """What a device of three axes, or one that takes a force, has to say besides its vectors."""

    buttons: Annotated[int, Field(ge=0, lt=2**16)] | None = Field(
        default=None, description="Buttons of the handle that are pressed, the first in bit 0; absent if it has none"
    )
    orientation: tuple[QuaternionPart, QuaternionPart, QuaternionPart, QuaternionPart] | None = Field(
        default=None, description="Orientation of the handle in the master frame, w x y z; absent if it is not measured"
    )
    hand_energy_j: EnergyJ | None = Field(
        default=None,
        description="Energy that the hand has put into the forces of its device, less what it got [J]; impedance type",
    )
    coupling_energy_j: EnergyJ | None = Field(
        default=None,
        description="Energy that the virtual coupling has taken in, less what it gave out [J]; below 0 it makes energy",
    )


class StageVolts(BaseModel):
    """What a real instrument's converters had, before any calibration."""

    output_v: VoltageV | None = Field(default=None, description="Output to the stage, read back [V]")
    input_v: VoltageV | None = Field(default=None, description="Input of the deflection [V]")


class FeltChannel(BaseModel):
    """What the hand feels where that is no force on the tip: a measured channel, by a table of the instrument."""

    felt_channel: Literal["frequency_shift", "current", "amplitude", "phase"] | None = Field(
        default=None,
        description="Channel that tip_force_n along z is made of, which is no force then; absent otherwise",
    )
    felt_value: ChannelValue | None = Field(
        default=None, description="Its value [Hz, A, m or rad]; absent where it is no number"
    )
    felt_clamp: Literal["", "saturated", "bounds", "rate", "left"] | None = Field(
        default=None, description="What limits the force made of it; left: the value has left the branch of the table"
    )


HAND_COUNTS, STAGE_VOLTS = tuple(HandCounts.model_fields), tuple(StageVolts.model_fields)
COUPLED_HAND = tuple(CoupledHand.model_fields)
FELT_CHANNEL = tuple(FeltChannel.model_fields)
LATERAL_FORCE_N: Any = Field(
    default=None,
    description="Force on the tip by the sample along x [N]; absent where it is not measured",
)
DISSIPATED_J: Any = Field(
    default=None,
    description="Energy that the sample takes from the tip in a period of its vibration [J]; absent in contact mode",
)
TORSION_RAD: Any = Field(
    default=None,
    description="Torsion of the cantilever that this force makes: over lateral stiffness and height of the tip [rad]",
)

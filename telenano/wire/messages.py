"""Every message that crosses the bus.

Frames: one right-handed frame a site, z up, away from the sample. A force is the force on the body named. The
paper's one-dimensional symbols are x_m = -z of the hand, F_m = -F_z on the device, x_s = -z of the AFM base
(origin at its rest point), F_s = F_z on the tip.

Make messages with `telenano.wire.compose`, which checks them: the constructor of a class here runs only the checks of
`__post_init__`. The order of the fields is their order on the wire. An optional key has the default None, which is
never sent.
"""

import math
import sys
from typing import Annotated, Any, ClassVar, Literal, dataclass_transform, get_type_hints

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from telenano.wire.ranges import (
    ANGLE,
    ENERGY,
    FORCE,
    POSITION,
    ChannelValue,
    DurationS,
    EnergyJ,
    ForceN,
    ForceVector,
    Percent,
    PositionM,
    PositionVector,
    PowerW,
    QuaternionPart,
    RateHz,
    TimeS,
    VelocityMPerS,
    VelocityVector,
    VoltageV,
    WaveVector,
    WayVector,
)

MAX_ITEMS = 4096
MAX_KEYS = 1024
# Most rows of a table of records, such as the inputs of a node.
MAX_ROWS = 1024
MAX_TEXT = 4096
# This reason in `rejected` of node/health is no fault: a newer message was already waiting.
SUPERSEDED = "superseded"

SOURCE_PATTERN = r"^[a-z][a-z0-9_]*@[a-z][a-z0-9_]*$"

Vector3 = tuple[float, float, float]
Scalar = bool | int | float | str


def about(description: str | None = None, pattern: str | None = None, **rules: Any) -> Meta:
    """Return the description and rules of a field; the `$` that ends a pattern matches only at the end of the text."""
    # In Python `$` also matches before a final newline, and `\Z` does not.
    whole = pattern and pattern.removesuffix("$") + r"\Z"
    return Meta(description=description, pattern=whole, **rules)


Source = Annotated[str, about(pattern=SOURCE_PATTERN, max_length=64)]
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Run = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Stamp = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
RawCount = Annotated[int, Meta(ge=-(2**31), le=2**31 - 1)]
# A message without maps and lists has at most 4096 bytes (`telenano.wire.codec`), which also limits its texts.
Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Name = Annotated[str, Meta(max_length=64)]
LawName = Annotated[str, about(pattern=r"^[a-z][a-z0-9_]*$", max_length=32)]
_Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
# The link reports its delay rounded down to this step [ns], so an age may come out too great by less than one step.
DELAY_STEP_NS = 1_000_000
Facts = Annotated[dict[str, bool | int | _Finite | str], Meta(max_length=MAX_KEYS)]
Counts = Annotated[dict[str, Count], Meta(max_length=MAX_KEYS)]
# Name of a person at the rig.
PersonName = Annotated[str, Meta(min_length=1, max_length=64)]
Latches = Annotated[dict[str, Name], Meta(max_length=MAX_KEYS)]
DeviceStatus = Literal["ok", "stale", "lost"]

_DTYPES: dict[str, npt.DTypeLike] = {"u1": "u1", "i2": "<i2", "i4": "<i4", "i8": "<i8", "f4": "<f4", "f8": "<f8"}


class _RecordMeta(msgspec.StructMeta):
    """Makes the fields of every record keyword-only: unlike other options of msgspec, `kw_only` is not inherited."""

    def __new__(mcls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> Any:
        return super().__new__(mcls, name, bases, namespace, kw_only=True, **options)


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Record(
    msgspec.Struct, frozen=True, gc=False, omit_defaults=True, forbid_unknown_fields=True, metaclass=_RecordMeta
):
    """An immutable part of a message."""


class Message(Record):
    """The header: the fields with which every message begins."""

    version: ClassVar[int] = 1

    seq: Annotated[Count, about("Number of this message on its topic from this source, counted from 0")]
    t_ns: Annotated[Count, about("Publisher's clock [ns]: Unix epoch at its start, advanced by the monotonic clock")]
    # `accept` checks the pattern once for each source: in each message that would take as long as all the rest.
    src: Annotated[str, about("Publisher, node@site", max_length=64, extra_json_schema={"pattern": SOURCE_PATTERN})]
    v: Annotated[int, about("Schema version of this message", ge=1)]
    run: Annotated[Run | None, about("Process of src that numbers its messages; another one after each restart")] = None


class _OfHand(Message):
    """A message that descends from a sample of the hand; the time of that sample gives the age of the loop."""

    hand_seq: Annotated[Count, about("seq of the haptic/state that this message answers or descends from")]
    hand_t_ns: Annotated[Count, about("t_ns of that haptic/state, on the master's clock [ns]; 0 = none yet")]


class Array(Record):
    """An array of numbers, little-endian, in C order."""

    dtype: Annotated[Literal["u1", "i2", "i4", "i8", "f4", "f8"], about("Element type: kind and bytes, little-endian")]
    shape: Annotated[tuple[Annotated[int, Meta(ge=0, le=2**24)], ...], about("Length of each axis", max_length=4)]
    data: Annotated[bytes, about("Elements in C order")]

    def __post_init__(self) -> None:
        """Raise ValueError if the size of the data does not fit the shape, or if a float is not finite."""
        expected = math.prod(self.shape) * np.dtype(_DTYPES[self.dtype]).itemsize
        if len(self.data) != expected:
            raise ValueError(
                f"data holds {len(self.data)} bytes, shape {list(self.shape)} of {self.dtype} needs {expected}"
            )
        if self.dtype in ("f4", "f8") and not np.isfinite(self.to_numpy()).all():
            raise ValueError("data holds NaN or infinity")

    @classmethod
    def from_numpy(cls, array: npt.NDArray[np.generic]) -> "Array":
        """Pack a NumPy array of up to four axes; raise ValueError for an unsupported element type."""
        name = f"{array.dtype.kind}{array.dtype.itemsize}"
        if name not in _DTYPES:
            raise ValueError(f"element type {array.dtype} cannot be sent, use one of {', '.join(_DTYPES)}")
        data = np.ascontiguousarray(array, dtype=_DTYPES[name]).tobytes()
        return msgspec.convert({"dtype": name, "shape": array.shape, "data": data}, cls)

    def to_numpy(self) -> npt.NDArray[np.generic]:
        """Return the elements as a read-only numpy array of `shape`."""
        array: npt.NDArray[np.generic] = np.frombuffer(self.data, dtype=_DTYPES[self.dtype]).reshape(self.shape)
        return array


Lengths = Annotated[Array, POSITION.of_elements()]
Angles = Annotated[Array, ANGLE.of_elements()]
Forces = Annotated[Array, FORCE.of_elements()]
Energies = Annotated[Array, ENERGY.of_elements()]

# Keys of a real device; they are absent if the device is simulated.
DeviceState = Annotated[
    DeviceStatus | None,
    about("State of a real device: stale repeats its last sample, lost is not driven. Absent if simulated"),
]
SampleAgeS = Annotated[
    DurationS | None, about("Age of the sample of a real device when published [s]; absent if simulated")
]
HandArmed = Annotated[
    bool | None,
    about(
        "In the sample of hand_seq the hand was armed and had a fresh answer of the tip's site at most 0.35 s before; "
        "the tip follows only commands for which this is true; absent counts as false"
    ),
]


class HapticState(Message):
    """The operator's device: measured values, and the values applied after every limit."""

    buttons: Annotated[
        Annotated[int, Meta(ge=0, le=2**16 - 1)] | None,
        about("Buttons of the handle that are pressed, the first in bit 0; absent if it has none"),
    ] = None
    orientation: Annotated[
        tuple[QuaternionPart, QuaternionPart, QuaternionPart, QuaternionPart] | None,
        about("Orientation of the handle in the master frame, w x y z; absent if it is not measured"),
    ] = None
    hand_energy_j: Annotated[
        EnergyJ | None,
        about("Net energy that the hand has put into the forces of its device [J]; impedance type"),
    ] = None
    limited_by: Annotated[
        Literal["travel", "speed", "force", "operator_force", "end_stop", "voltage", "torque"] | None,
        about("Limit that is acting, the most lasting one of several; absent if none is"),
    ] = None
    coupling_energy_j: Annotated[
        EnergyJ | None,
        about("Net energy that the virtual coupling has absorbed [J]; below 0 the coupling has generated energy"),
    ] = None
    # Raw values of the handle, so that a better calibration can be applied later.
    position_raw: Annotated[RawCount | None, about("Position as the handle sent it [counts]")] = None
    velocity_raw: Annotated[RawCount | None, about("Velocity as the handle sent it [counts/s]")] = None
    operator_force_raw: Annotated[RawCount | None, about("Operator's force as it was sent [counts]")] = None
    drive_raw: Annotated[RawCount | None, about("Drive after every limit as it was sent [counts]")] = None
    position_m: Annotated[
        PositionVector, about("Hand position in the master frame [m]; z = -x_m, 0 where the arm starts")
    ]
    velocity_m_per_s: Annotated[VelocityVector, about("Hand velocity in the master frame [m/s]")]
    operator_force_n: Annotated[ForceVector, about("Force on the device by the operator [N]; pushing is -z, F_m = -z")]
    motor_force_n: Annotated[
        ForceVector, about("Force of the motor at the arm after every limit, its friction included [N]")
    ]
    reference_m: Annotated[
        PositionVector, about("Position reference after every limit [m]; meaningful in mode position")
    ]
    mode: Annotated[Literal["off", "position", "force"], about("Mode of the motor; off is zero force")]
    estop: Annotated[bool, about("Emergency stop is latched")]
    limited: Annotated[bool, about("A travel, speed or force limit is acting")]
    session_s: Annotated[
        TimeS, about("Time of the operator's force profile [s]; negative = the session is not running")
    ]
    answered_seq: Annotated[Count, about("hand_seq of the newest haptic/command; meaningful once answered_t_ns > 0")]
    answered_t_ns: Annotated[Count, about("hand_t_ns of the newest haptic/command [ns]; 0 = none yet")]
    answered_at_ns: Annotated[Count, about("Time at which that command reached this device, on the clock of t_ns [ns]")]
    step_s: Annotated[DurationS, about("Time that this step of the device covers [s]")]
    device: DeviceState = None
    sample_age_s: SampleAgeS = None
    armed: Annotated[
        bool | None,
        about(
            "A person has armed the hand since its start and its last emergency stop, and its device is not lost; the "
            "tip follows only a hand for which this is true; absent counts as false"
        ),
    ] = None


class OperatorForce(Message):
    """Force of an operator without a device, entered on the page of the view, for the simulated device."""

    force_n: Annotated[
        ForceVector, about("Force on the device by the operator in the master frame [N]; pushing is -z, F_m = -z")
    ]
    by: Annotated[PersonName | None, about("Name of the person who holds control, if it is known")] = None


class HapticCommand(_OfHand):
    """Command of the master half of the law to the operator's device."""

    mode: Annotated[Literal["off", "position", "force"], about("off, track position_m, or render force_n")]
    position_m: Annotated[PositionVector, about("Position reference in the master frame [m]; z = -x_mr")]
    velocity_m_per_s: Annotated[VelocityVector, about("Velocity of that reference [m/s]")]
    force_n: Annotated[ForceVector, about("Force of the environment at the hand's scale [N]; z = alpha_f F_s")]


class _Teleop(_OfHand):
    """Signal from one half of a law to the other; a law that does not use an optional field sends nil."""

    law: Annotated[LawName, about("Law that this message belongs to")]
    active: Annotated[bool, about("The device of the sending site follows the law")]
    position_m: Annotated[WayVector, about("Position at the slave's scale, AFM frame [m]; forward: reference")]
    velocity_m_per_s: Annotated[VelocityVector, about("Velocity at the slave's scale, AFM frame [m/s]")]
    force_n: Annotated[ForceVector, about("Force at the slave's scale, AFM frame [N]; backward: on the tip")]
    wave_sqrt_w: Annotated[WaveVector | None, about("Wave variable [sqrt(W)]; nil where the law has none")]
    energy_j: Annotated[EnergyJ | None, about("Energy that entered at this side [J]; nil where the law has none")]


class TeleopForward(_Teleop):
    """Signal from the master half of a law to the slave half."""

    hand_armed: HandArmed = None


class TeleopBackward(_Teleop):
    """Signal from the slave half of a law to the master half."""

    separation_m: Annotated[PositionM, about("Tip-sample distance h [m]; 0 when separation_valid is false")]
    separation_valid: Annotated[bool, about("The instrument knows the tip-sample distance")]
    in_contact: Annotated[bool, about("The tip touches the sample")]


class AfmCommand(_OfHand):
    """Command of the slave half of the law to the AFM."""

    mode: Annotated[Literal["position", "hold", "retract"], about("Follow base_position_m, stay, or withdraw")]
    base_position_m: Annotated[
        PositionVector, about("Base reference in the AFM frame [m]; z = -x_s, 0 is the rest point")
    ]
    lateral_m: Annotated[
        tuple[PositionM, PositionM] | None,
        about(
            "Place of the stage that the hand commands, x and y in the AFM frame [m]; absent while no hand moves the "
            "tip across the sample"
        ),
    ] = None
    hand_armed: HandArmed = None
    hand_force_n: Annotated[ForceN | None, about("Force of the hand at hand_seq [N]; towards the sample > 0")] = None


class AfmState(_OfHand):
    """The AFM: measured values, and the values applied after every limit."""

    # Raw values of the converters of a real instrument, before any calibration.
    output_v: Annotated[VoltageV | None, about("Output to the stage, read back [V]")] = None
    input_v: Annotated[VoltageV | None, about("Input of the deflection [V]")] = None
    # A measured channel that the hand feels instead of the force on the tip, converted by a table of the instrument.
    felt_channel: Annotated[
        Literal["frequency_shift", "current", "amplitude", "phase"] | None,
        about(
            "Measured channel from which a table computes tip_force_n along z, which is no force then; absent otherwise"
        ),
    ] = None
    felt_value: Annotated[
        ChannelValue | None, about("Value of that channel [Hz, A, m or rad]; absent if it is not a number")
    ] = None
    felt_clamp: Annotated[
        Literal["", "saturated", "bounds", "rate", "left"] | None,
        about("Limit acting on the force computed from it; left: the value has left the branch of the table"),
    ] = None
    limited_by: Annotated[
        Literal["range", "speed", "area", "lateral_speed"] | None,
        about(
            "Limit that is acting: of the base its range or speed, or of the stage its area or speed; the most lasting "
            "one of several, and absent if none is"
        ),
    ] = None
    command_seq: Annotated[Count, about("seq of the afm/command in force; meaningful once hand_t_ns > 0")]
    base_position_m: Annotated[PositionVector, about("Base position applied after every limit [m]; z = -x_s")]
    deflection_m: Annotated[PositionM, about("Deflection zeta of the cantilever [m], positive away from the sample")]
    tip_force_n: Annotated[ForceVector, about("Force on the tip by the sample [N]; repulsive is +z")]
    separation_m: Annotated[PositionM, about("Tip-sample distance h [m]; 0 when separation_valid is false")]
    separation_valid: Annotated[bool, about("The instrument knows the tip-sample distance")]
    in_contact: Annotated[bool, about("The tip touches the sample")]
    meniscus: Annotated[bool, about("A liquid bridge joins tip and sample")]
    mode: Annotated[Literal["retracted", "follow", "hold", "retracting", "estop"], about("Mode of the AFM")]
    limited: Annotated[bool, about("A travel or speed limit is acting")]
    step_s: Annotated[DurationS, about("Time that this step of the instrument covers [s]")]
    device: DeviceState = None
    sample_age_s: SampleAgeS = None
    armed: Annotated[
        bool | None, about("The tip was armed and may move; in mode retracted it waits for a command of an armed hand")
    ] = None
    placed: Annotated[
        bool | None,
        about(
            "The commanded base has reached its reference after every limit, or the program that began with arming is "
            "running"
        ),
    ] = None
    offset_m: Annotated[
        PositionM | None,
        about(
            "Distance by which the base stays further from the sample than afm/command asks for [m], the offset "
            "between hand and base; absent if there is none"
        ),
    ] = None
    return_place_m: Annotated[
        PositionM | None,
        about(
            "Position to which the base would return after a command arm with this as place_m [m], towards the sample "
            "> 0; absent if there is no way back"
        ),
    ] = None
    return_speed_m_per_s: Annotated[VelocityMPerS | None, about("Speed of that return [m/s]")] = None
    return_s: Annotated[DurationS | None, about("Duration of that return [s]")] = None


class AfmScanline(Message):
    """A finished line of an image."""

    line: Annotated[Count, about("Number of the line, from 0")]
    lines: Annotated[int, about("Lines in the image", ge=1, le=2**20)]
    direction: Annotated[Literal["trace", "retrace"], about("Sense of the fast axis")]
    start_m: Annotated[PositionVector, about("First point of the line in the AFM frame [m]")]
    end_m: Annotated[PositionVector, about("Last point of the line in the AFM frame [m]")]
    height_m: Annotated[Lengths, about("Height at equal steps along the line [m]")]
    amplitude_m: Annotated[Lengths | None, about("Amplitude of vibration [m]; nil in contact mode")]
    phase_rad: Annotated[Angles | None, about("Phase of vibration [rad]; nil in contact mode")]
    lateral_force_n: Annotated[
        Forces | None, about("Force on the tip by the sample along x [N]; absent where it is not measured")
    ] = None
    torsion_rad: Annotated[
        Angles | None,
        about(
            "Torsion of the cantilever under this force [rad]: the force divided by lateral stiffness and tip height"
        ),
    ] = None
    dissipated_j: Annotated[
        Energies | None,
        about("Energy that the tip loses to the sample in a period of its vibration [J]; absent in contact mode"),
    ] = None


class LawStatus(Message):
    """State of one half of the law: its energy, passivity and reception; energies at the hand's scale."""

    law: Annotated[LawName, about("Law in force at this half")]
    switching: Annotated[
        bool, about("The half waits until the other one has changed to this law; meanwhile its device stands still")
    ]
    port_energy_j: Annotated[
        EnergyJ, about("Energy that has entered the law at this port since it came into force [J]")
    ]
    port_power_w: Annotated[PowerW, about("Power entering at this port, mean since the last report [W]")]
    net_valid: Annotated[bool, about("The energy of the other port is known too")]
    net_energy_j: Annotated[
        EnergyJ, about("Net energy that has entered the law at both ports [J]; it is stored or lost there")
    ]
    left_j: Annotated[
        EnergyJ, about("Energy reported by the other half that this half has not yet spent [J]; 0 if not counted")
    ]
    dissipated_j: Annotated[
        EnergyJ, about("Energy that the controller has dissipated on purpose [J]; 0 if not counted")
    ]
    passive: Annotated[
        bool, about("Neither the net energy nor the energy left shows that the law has generated energy")
    ]
    saved_percent: Annotated[
        Percent,
        about(
            "Share of the signals to the other half that the dead band has kept back since this law came into force [%]"
        ),
    ]
    heard: Annotated[bool, about("A signal of the other half in this law has been received")]
    silence_s: Annotated[DurationS, about("Time since the last such signal [s]; 0 if none was received")]
    round_trip_valid: Annotated[bool, about("The round trip was measured; at the master only")]
    round_trip_s: Annotated[DurationS, about("Age of the hand's sample that the newest answer descends from [s]")]


class LinkDirection(Record):
    """One direction of the link: settings in force, counts since the start, and delays since the last report."""

    profile: Annotated[
        Text,
        about(
            "Name of the network in force: a profile, `constant delay`, `custom`, or a changed profile as in `lte, "
            "changed`"
        ),
    ]
    settings: Annotated[Facts, about("Settings in force, by dotted key; SI units in the names")]
    messages_in: Annotated[Count, about("Messages taken in since the start")]
    messages_out: Annotated[Count, about("Messages delivered since the start, duplicates included")]
    dropped: Annotated[Counts, about("Messages dropped since the start, by cause")]
    duplicated: Annotated[Count, about("Messages duplicated since the start")]
    reordered: Annotated[Count, about("Messages that overtook an earlier one since the start")]
    corrupted: Annotated[Count, about("Messages corrupted since the start")]
    queue_depth: Annotated[Count, about("Messages in flight now")]
    delay_valid: Annotated[bool, about("At least one message was delivered since the last report")]
    delay_mean_s: Annotated[DurationS, about("Mean delay applied since the last report [s]")]
    delay_min_s: Annotated[DurationS, about("Least delay applied since the last report [s]")]
    delay_max_s: Annotated[DurationS, about("Greatest delay applied since the last report [s]")]


class LinkClock(Record):
    """Offset between the clocks of the sites, from four time stamps; figures are 0 when valid is false."""

    valid: Annotated[bool, about("An exchange with the slave's site was completed")]
    offset_s: Annotated[TimeS, about("Slave's clock minus the master's clock [s]")]
    uncertainty_s: Annotated[
        DurationS,
        about("Bound of the error of offset_s [s]: half the shortest round trip in the window of the minimum filter"),
    ]
    round_trip_s: Annotated[DurationS, about("Present least round trip [s]; a change to a longer route shows at once")]
    exchanges: Annotated[Count, about("Number of exchanges in the window of the minimum filter")]
    round_trip_low_s: Annotated[
        DurationS | None, about("Lower end of the interval of round_trip_s [s]; absent before the first exchange")
    ] = None
    round_trip_high_s: Annotated[
        DurationS | None, about("Upper end of the interval of round_trip_s [s]; absent before the first exchange")
    ] = None
    round_trip_since_ns: Annotated[
        Count | None,
        about(
            "Start of the present state of the round trip, on the asking clock [ns]; absent before the first exchange"
        ),
    ] = None


class LinkStatus(Message):
    """State of the link in both directions."""

    forward: Annotated[LinkDirection, about("From the master to the slave")]
    backward: Annotated[LinkDirection, about("From the slave to the master")]
    clock: Annotated[
        LinkClock, about("Offset between the clocks of the sites, from exchanges that bypass the impairments")
    ]
    answer_sent_ns: Annotated[
        Count | None, about("t_ns of the newest clock/pong, on the answering clock [ns]; absent before the first")
    ] = None
    answer_received_ns: Annotated[
        Count | None, about("Time at which that clock/pong arrived at the link, on the asking clock [ns]")
    ] = None


class LinkDelay(Message):
    """Delay that the way between the sites adds to the age of the hand's samples, from one sample on.

    The link sends it before the first message that descends from that sample, whenever the delay changes by a step,
    and with every link/status; to the slave's site of two machines only once it has measured their clocks. It tells a
    reader which part of an age is the experiment's delay, and which a fault.
    """

    direction: Annotated[Literal["forward", "backward"], about("forward: from the master to the slave")]
    hand_t_ns: Annotated[Count, about("t_ns of the first haptic/state that it applies to, on its own clock [ns]")]
    delay_ns: Annotated[Count, about("Delay applied on purpose, rounded down to whole milliseconds [ns]")]
    transit_ns: Annotated[
        Count, about("Present least additional time of a message between two machines [ns]; 0 on one machine")
    ]
    clock_ahead_ns: Annotated[
        Stamp, about("Slave's clock minus the master's clock [ns]; 0 if no difference is resolved")
    ]

    @staticmethod
    def reported_ns(delay_ns: int) -> int:
        """Return the part of a delay that the link reports [ns].

        >>> LinkDelay.reported_ns(20_400_000)
        20000000
        """
        return delay_ns - delay_ns % DELAY_STEP_NS


class LinkFate(Record):
    """Ground truth of one message that reached the link, or of the duplicate that was made of it."""

    topic: Annotated[Name, about("Topic of the message")]
    seq: Annotated[Count, about("seq of the message")]
    is_duplicate: Annotated[bool, about("This is the duplicate, not the message itself")]
    arrived_ns: Annotated[Count, about("Time at which it reached the link, on the link's clock [ns]")]
    delay_ns: Annotated[Count, about("Delay applied, everything included [ns]; 0 when dropped")]
    queue_ns: Annotated[Count, about("Part of it spent in the queue of a rate limit or delivery trace [ns]")]
    held_ns: Annotated[Count, about("Part of it spent waiting for the end of an outage [ns]")]
    dropped: Annotated[
        Name,
        about(
            "Cause of its loss: outage, loss, markov_loss, gilbert_elliott, loss_trace, queue, stop; empty if not "
            "dropped"
        ),
    ]
    duplicated: Annotated[bool, about("A duplicate was made of it")]
    reordered: Annotated[bool, about("It was released before a message of its topic that had arrived earlier")]
    corrupted: Annotated[bool, about("Bits of it were flipped")]


class LinkFates(Message):
    """Fate of each message of one direction in the link since the last such report."""

    direction: Annotated[Literal["forward", "backward"], about("forward: from the master to the slave")]
    fates: Annotated[
        tuple[LinkFate, ...], about("Fates in the order in which the link decided them", max_length=MAX_ROWS)
    ]


class ClockPing(Message):
    """Question of the link to the other site for its time."""


class ClockPong(Message):
    """Answer to a clock/ping; its own t_ns is the time of sending on the answering clock."""

    ping_t_ns: Annotated[Count, about("t_ns of the question, on the asking clock [ns]")]
    received_ns: Annotated[Count, about("Time at which the question arrived, on the answering clock [ns]")]


class SessionControl(Message):
    """A command to the nodes of a session; each node it concerns answers with a session/event of the same id."""

    id: Annotated[str, about("Identifier that the answers repeat", pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    command: Annotated[
        Literal["start", "stop", "arm", "estop", "set", "mark"],
        about(
            "start or stop the operator's force profile; arm the devices; stop at once and latch; set parameters; "
            "mark this moment in the recording"
        ),
    ]
    target: Annotated[str, about("Nodes concerned: node@site, node, or *; wildcards as in file names", max_length=64)]
    parameters: Annotated[Facts, about("Parameters of the command by dotted key; units in the names")]
    validity_s: Annotated[
        DurationS | None, about("Time after t_ns within which a node may carry it out [s]; 1 s if absent")
    ] = None
    node_t_ns: Annotated[
        Counts | None,
        about("By node@site: t_ns of the newest message received from it, on the clock of that node [ns]"),
    ] = None
    node_latch: Annotated[
        Latches | None,
        about(
            "By node@site: `latch` from the data of the refusal that this command answers; it names the node's run "
            "and counts its emergency stops"
        ),
    ] = None
    by: Annotated[
        PersonName | None,
        about("Name of the person who gave the command, if it is known; the answers repeat it in their data"),
    ] = None


class SessionEvent(Message):
    """An event at a node: the answer to a command, a change of state, a mark or a fault."""

    id: Annotated[
        str,
        about("Id of the command answered; empty if no command asked for the event", pattern=r"^[A-Za-z0-9_-]{0,64}$"),
    ]
    kind: Annotated[
        Literal["ack", "refused", "mode", "link", "network", "node", "recording", "mark", "fault"],
        about(
            "ack and refused answer a command; mode: a device changed mode; link, network, node, recording: a change "
            "of their state; mark: a mark of the operator; fault: a fault occurred and was handled"
        ),
    ]
    level: Annotated[Literal["info", "warning", "error"], about("Severity")]
    text: Annotated[Text, about("One sentence for a person")]
    data: Annotated[Facts, about("The same facts for a program; units in the names")]


class InputHealth(Record):
    """Reception of one topic from one source at a node."""

    topic: Annotated[Text, about("Topic")]
    src: Annotated[Text, about("Publisher, node@site; empty when nothing was ever received")]
    received: Annotated[Count, about("Messages accepted since the start")]
    lost: Annotated[Count, about("Messages missing by sequence gaps since the start")]
    gaps: Annotated[Count, about("Sequence gaps since the start")]
    repeated: Annotated[Count, about("Messages that came twice or out of order since the start")]
    restarts: Annotated[Count, about("Restarts of the publisher seen since the start")]
    age_valid: Annotated[bool, about("At least one message was received")]
    age_s: Annotated[TimeS, about("Time since the publisher sent the newest message [s]; it compares two clocks")]


class NodeHealth(Message):
    """Health of the process of a node: state, timing of the loop, inputs and device."""

    pid: Annotated[Count, about("Process id")]
    state: Annotated[Literal["starting", "ready", "running", "safe", "stopping"], about("State of the node")]
    uptime_s: Annotated[DurationS, about("Time since the node started [s]")]
    rate_hz: Annotated[RateHz, about("Steps a second since the last report")]
    period_s: Annotated[DurationS, about("Nominal period of the loop [s]; 0 = acts on messages only")]
    lateness_p50_s: Annotated[DurationS, about("Median lateness against the deadline since the last report [s]")]
    lateness_p99_s: Annotated[DurationS, about("99th percentile of the lateness since the last report [s]")]
    lateness_max_s: Annotated[DurationS, about("Greatest lateness since the last report [s]")]
    overruns: Annotated[Count, about("Deadlines missed by a period or more since the start")]
    rejected: Annotated[
        Counts,
        about(
            "Frames and connections refused since the start, by reason; superseded: a newer message of a `latest` "
            "topic was already waiting; stale: older than the deadline of its topic"
        ),
    ]
    cpu_percent: Annotated[
        Percent, about("Processor time used since the last report [% of one core]", extra={"heading": "CPU %"})
    ]
    memory_bytes: Annotated[Count, about("Resident memory [bytes]", extra={"heading": "MB"})]
    realtime: Annotated[bool, about("SCHED_FIFO is in force")]
    memory_locked: Annotated[bool, about("Memory is locked")]
    replay: Annotated[bool, about("The messages of this node come from a recording, not from an instrument")]
    inputs: Annotated[
        tuple[InputHealth, ...],
        about("Every input of the node; of too many sources, those that sent most", max_length=MAX_ROWS),
    ]
    device_latency_s: Annotated[
        DurationS | None,
        about(
            "Latency that a real device is declared to add to the round trip [s]: mean time from a command to the "
            "sample that answers it; absent if simulated"
        ),
    ] = None
    device_age_s: Annotated[
        DurationS | None,
        about("Mean age of the samples of a real device since the last report [s]; absent if there were none"),
    ] = None
    calibration: Annotated[
        Annotated[str, Meta(max_length=128)] | None,
        about("Device and date of the calibration that is in use; absent if simulated"),
    ] = None
    force_limit_n: Annotated[
        ForceN | None,
        about(
            "Force on the tip above which the guard of this node withdraws it [N]; absent where it has no such guard"
        ),
    ] = None
    travel_m: Annotated[
        tuple[PositionM, PositionM] | None,
        about(
            "Ends of the travel that the guard of this node allows the hand [m], the one away from the sample first; "
            "towards the sample > 0; absent where it guards no hand"
        ),
    ] = None
    deaf_s: Annotated[
        Annotated[dict[str, DurationS], Meta(max_length=MAX_KEYS)] | None,
        about(
            "Publishers that send but from which this node receives nothing, each with the duration of that [s]; "
            "absent if there are none"
        ),
    ] = None
    shares_with: Annotated[
        Annotated[tuple[Name, ...], Meta(max_length=MAX_KEYS)] | None,
        about(
            "Other nodes that run in the same process, whose reports have its pid, cpu_percent and memory_bytes as "
            "well: a sum counts them once; absent where the node has a process of its own"
        ),
    ] = None
    open_files: Annotated[
        Count | None,
        about(
            "Files and sockets that the process has open; absent where the system does not tell",
            extra={"heading": "files"},
        ),
    ] = None
    most_open_files: Annotated[
        Count | None, about("Files and sockets that the process may have open; absent without a limit")
    ] = None


# The fields of node/health with a heading are figures of the process, which all of its nodes report. `telenano status`
# and `telenano up` show such a figure once, in a column with its heading.
PROCESS_FIGURES: dict[str, str] = {
    name: note.extra["heading"]
    for name, hint in get_type_hints(NodeHealth, include_extras=True).items()
    for note in getattr(hint, "__metadata__", ())
    if isinstance(note, Meta) and note.extra is not None and "heading" in note.extra
}

"""Every message that crosses the bus.

Frames: one right-handed frame a site, z up, away from the sample. A force is the force on the body named. The
paper's one-dimensional symbols are x_m = -z of the hand, F_m = -F_z on the device, x_s = -z of the AFM base
(origin at its rest point), F_s = F_z on the tip.
"""

import math
from collections.abc import Collection, Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt
from pydantic import (
    BaseModel,
    ConfigDict,
    FailFast,
    Field,
    GetCoreSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from telenano.wire import device as real
from telenano.wire.ranges import (
    ANGLE,
    ENERGY,
    FORCE,
    POSITION,
    DurationS,
    Elements,
    EnergyJ,
    ForceVector,
    Percent,
    PositionM,
    PositionVector,
    PowerW,
    RateHz,
    TimeS,
    VelocityVector,
    WaveVector,
    WayVector,
)

# The limits are far above what any message needs: without them a megabyte of empty maps costs gigabytes and a minute to
# refuse.
MAX_ITEMS = 4096
MAX_KEYS = 1024
# The rows of a table of records, such as the inputs of a node.
MAX_ROWS = 1024
MAX_TEXT = 4096
# This is the one reason in node/health for which a message is not acted on although nothing is wrong.
SUPERSEDED = "superseded"

SOURCE_PATTERN = r"^[a-z][a-z0-9_]*@[a-z][a-z0-9_]*$"

Vector3 = tuple[float, float, float]
Scalar = bool | int | float | str


class _OneFault:
    """Report a value that is none of several kinds as one fault, not as one a kind: a thousand of them are dear."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the kinds with an error of its own."""
        message = "Input should be a finite number, true or false, or text"
        return core_schema.custom_error_schema(handler(source), "scalar", custom_error_message=message)


Source = Annotated[str, Field(pattern=SOURCE_PATTERN, max_length=64)]
Count = Annotated[int, Field(ge=0, le=2**63 - 1)]
Text = Annotated[str, Field(max_length=MAX_TEXT)]
Facts = Annotated[dict[str, Annotated[Scalar, _OneFault()]], Field(max_length=MAX_KEYS)]
Counts = Annotated[dict[str, Count], Field(max_length=MAX_KEYS)]
# This is the name that a person was given at the rig.
PersonName = Annotated[str, Field(min_length=1, max_length=64)]
Latches = Annotated[dict[str, Annotated[str, Field(max_length=64)]], Field(max_length=MAX_KEYS)]

_DTYPES: dict[str, npt.DTypeLike] = {"u1": "u1", "i2": "<i2", "i4": "<i4", "i8": "<i8", "f4": "<f4", "f8": "<f8"}


class Record(BaseModel):
    """A checked, immutable part of a message: NaN, infinity and, where it is made, unknown keys are refused."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Message(Record):
    """The header that every message carries."""

    version: ClassVar[int] = 1
    # optional keys, with the version that a message with each has: None stands for a key that is absent on the wire
    additions: ClassVar[Mapping[str, int]] = {}

    seq: Count = Field(description="Number of this message on its topic from this source, counted from 0")
    t_ns: Count = Field(description="Publisher's clock [ns]: Unix epoch at its start, advanced by the monotonic clock")
    src: Source = Field(description="Publisher, node@site")
    v: int = Field(ge=1, description="Schema version of this message")

    @classmethod
    def version_of(cls, keys: Collection[str]) -> int:
        """Return the version of a message with these keys: older readers take one without the newer keys."""
        if not cls.additions:
            return cls.version
        return max((added for key, added in cls.additions.items() if key in keys), default=1)


class _Extended(Message):
    """A message with keys that may be absent."""

    @model_serializer(mode="wrap")
    def _present(self, serialize: SerializerFunctionWrapHandler) -> dict[str, object]:
        fields: dict[str, object] = serialize(self)
        return {key: value for key, value in fields.items() if value is not None or key not in self.additions}


class Array(Record):
    """An array of numbers, little-endian, in C order."""

    dtype: Literal["u1", "i2", "i4", "i8", "f4", "f8"] = Field(
        description="Element type: kind and bytes, little-endian"
    )
    shape: tuple[Annotated[int, Field(ge=0, le=2**24)], ...] = Field(max_length=4, description="Length of each axis")
    data: bytes = Field(description="Elements in C order")

    @model_validator(mode="after")
    def _data_fills_shape(self) -> "Array":
        expected = math.prod(self.shape) * np.dtype(_DTYPES[self.dtype]).itemsize
        if len(self.data) != expected:
            raise ValueError(
                f"data holds {len(self.data)} bytes, shape {list(self.shape)} of {self.dtype} needs {expected}"
            )
        if self.dtype in ("f4", "f8") and not np.isfinite(self.to_numpy()).all():
            raise ValueError("data holds NaN or infinity")
        return self

    @classmethod
    def from_numpy(cls, array: npt.NDArray[np.generic]) -> "Array":
        """Pack a numpy array of a supported element type; ValueError names any other."""
        name = f"{array.dtype.kind}{array.dtype.itemsize}"
        if name not in _DTYPES:
            raise ValueError(f"element type {array.dtype} cannot be sent, use one of {', '.join(_DTYPES)}")
        data = np.ascontiguousarray(array, dtype=_DTYPES[name]).tobytes()
        return cls.model_validate({"dtype": name, "shape": array.shape, "data": data})

    def to_numpy(self) -> npt.NDArray[np.generic]:
        """Return the elements as a read-only numpy array of `shape`."""
        array: npt.NDArray[np.generic] = np.frombuffer(self.data, dtype=_DTYPES[self.dtype]).reshape(self.shape)
        return array


Lengths = Annotated[Array, Elements(POSITION)]
Angles = Annotated[Array, Elements(ANGLE)]
Forces = Annotated[Array, Elements(FORCE)]
Energies = Annotated[Array, Elements(ENERGY)]


class _HandSample(Record):
    """Which sample of the hand a message descends from: what the age of the loop is measured with."""

    hand_seq: Count = Field(description="seq of the haptic/state that this message answers or descends from")
    hand_t_ns: Count = Field(description="t_ns of that haptic/state, on the master's clock [ns]; 0 = none yet")


class HapticState(real.HandCounts, real.CoupledHand, _Extended):
    """The operator's device: what was measured and what was really applied."""

    version: ClassVar[int] = 4
    additions: ClassVar[Mapping[str, int]] = {
        **dict.fromkeys(("device", "sample_age_s", *real.HAND_COUNTS), 2),
        **dict.fromkeys(real.COUPLED_HAND, 3),
        "armed": 4,
    }

    position_m: PositionVector = Field(
        description="Hand position in the master frame [m]; z = -x_m, 0 where the arm starts"
    )
    velocity_m_per_s: VelocityVector = Field(description="Hand velocity in the master frame [m/s]")
    operator_force_n: ForceVector = Field(
        description="Force on the device by the operator [N]; pushing is -z, F_m = -z"
    )
    motor_force_n: ForceVector = Field(
        description="Force of the motor at the arm after every limit, its friction included [N]"
    )
    reference_m: PositionVector = Field(
        description="Position reference after every limit [m]; meaningful in mode position"
    )
    mode: Literal["off", "position", "force"] = Field(description="What the motor does; off is zero force")
    estop: bool = Field(description="Emergency stop is latched")
    limited: bool = Field(description="A travel, speed or force limit is acting")
    session_s: TimeS = Field(description="Time of the operator's programme [s]; negative = the session is not running")
    answered_seq: Count = Field(description="hand_seq of the newest haptic/command; meaningful once answered_t_ns > 0")
    answered_t_ns: Count = Field(description="hand_t_ns of the newest haptic/command [ns]; 0 = none yet")
    answered_at_ns: Count = Field(description="When that command reached this device, on this clock [ns]")
    step_s: DurationS = Field(description="Time that this step of the device covers [s]")
    device: real.DeviceStatus | None = real.DEVICE
    sample_age_s: DurationS | None = real.SAMPLE_AGE_S
    armed: bool | None = Field(
        default=None,
        description="A person has armed the hand since its start and its last emergency stop, and it is there: a tip"
        " follows no other hand; absent counts as false",
    )


class OperatorForce(_Extended):
    """The force of an operator who has no device, for a simulated one: from the page of the view."""

    version: ClassVar[int] = 2
    additions: ClassVar[Mapping[str, int]] = {"by": 2}

    force_n: ForceVector = Field(
        description="Force on the device by the operator in the master frame [N]; pushing is -z, F_m = -z"
    )
    by: PersonName | None = Field(default=None, description="Name of who has the hand, where they were given one")


class HapticCommand(Message, _HandSample):
    """What the master half of the law asks of the device."""

    mode: Literal["off", "position", "force"] = Field(description="off, track position_m, or render force_n")
    position_m: PositionVector = Field(description="Position reference in the master frame [m]; z = -x_mr")
    velocity_m_per_s: VelocityVector = Field(description="Velocity of that reference [m/s]")
    force_n: ForceVector = Field(description="Force of the environment at the hand's scale [N]; z = alpha_f F_s")


class _Teleop(Message, _HandSample):
    """What the two halves of a law send to each other; a law that has no use for an optional part sends nil."""

    law: str = Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=32, description="Law that this message belongs to")
    active: bool = Field(description="The device of the sending site follows the law")
    position_m: WayVector = Field(description="Position at the slave's scale, AFM frame [m]; forward: reference")
    velocity_m_per_s: VelocityVector = Field(description="Velocity at the slave's scale, AFM frame [m/s]")
    force_n: ForceVector = Field(description="Force at the slave's scale, AFM frame [N]; backward: on the tip")
    wave_sqrt_w: WaveVector | None = Field(description="Wave variable [sqrt(W)]; nil where the law has none")
    energy_j: EnergyJ | None = Field(description="Energy that entered at this side [J]; nil where the law has none")


_HAND_ARMED = Field(
    default=None,
    description="The hand was armed in the sample of hand_seq: a tip follows no other command; absent counts as false",
)


class TeleopForward(_Teleop, _Extended):
    """From the master half of a law to the slave half."""

    version: ClassVar[int] = 2
    additions: ClassVar[Mapping[str, int]] = {"hand_armed": 2}

    hand_armed: bool | None = _HAND_ARMED


class TeleopBackward(_Teleop):
    """From the slave half of a law to the master half."""

    separation_m: PositionM = Field(description="Tip-sample distance h [m]; 0 when separation_valid is false")
    separation_valid: bool = Field(description="The instrument knows the tip-sample distance")
    in_contact: bool = Field(description="The tip touches the sample")


class AfmCommand(_Extended, _HandSample):
    """What the slave half of the law asks of the AFM."""

    version: ClassVar[int] = 3
    additions: ClassVar[Mapping[str, int]] = {"lateral_m": 2, "hand_armed": 3}

    mode: Literal["position", "hold", "retract"] = Field(description="Follow base_position_m, stay, or withdraw")
    base_position_m: PositionVector = Field(
        description="Base reference in the AFM frame [m]; z = -x_s, 0 is the rest point"
    )
    lateral_m: tuple[PositionM, PositionM] | None = Field(
        default=None,
        description="Where a hand that moves the tip across the sample wants the stage, x and y in the AFM frame [m]; "
        "absent while it does not",
    )
    hand_armed: bool | None = _HAND_ARMED


class AfmState(real.FeltChannel, real.StageVolts, _Extended, _HandSample):
    """The AFM: what was measured and what was really applied."""

    version: ClassVar[int] = 4
    additions: ClassVar[Mapping[str, int]] = {
        **dict.fromkeys(("device", "sample_age_s", *real.STAGE_VOLTS), 2),
        **dict.fromkeys(real.FELT_CHANNEL, 3),
        **dict.fromkeys(("armed", "placed"), 4),
    }

    command_seq: Count = Field(description="seq of the afm/command in force; meaningful once hand_t_ns > 0")
    base_position_m: PositionVector = Field(description="Base position applied after every limit [m]; z = -x_s")
    deflection_m: PositionM = Field(description="Deflection zeta of the cantilever [m], positive away from the sample")
    tip_force_n: ForceVector = Field(description="Force on the tip by the sample [N]; repulsive is +z")
    separation_m: PositionM = Field(description="Tip-sample distance h [m]; 0 when separation_valid is false")
    separation_valid: bool = Field(description="The instrument knows the tip-sample distance")
    in_contact: bool = Field(description="The tip touches the sample")
    meniscus: bool = Field(description="A liquid bridge joins tip and sample")
    mode: Literal["retracted", "follow", "hold", "retracting", "estop"] = Field(description="What the AFM does")
    limited: bool = Field(description="A travel or speed limit is acting")
    step_s: DurationS = Field(description="Time that this step of the instrument covers [s]")
    device: real.DeviceStatus | None = real.DEVICE
    sample_age_s: DurationS | None = real.SAMPLE_AGE_S
    armed: bool | None = Field(
        default=None,
        description="The tip was armed and may move; in mode retracted it waits for a command of an armed hand",
    )
    placed: bool | None = Field(
        default=None,
        description="The commanded base has reached its reference after every limit, or the program that was begun with"
        " arming is under way",
    )


class AfmScanline(_Extended):
    """A finished line of an image."""

    version: ClassVar[int] = 3
    additions: ClassVar[Mapping[str, int]] = {"lateral_force_n": 2, "torsion_rad": 2, "dissipated_j": 3}
    line: Count = Field(description="Number of the line, from 0")
    lines: Annotated[int, Field(ge=1, le=2**20)] = Field(description="Lines in the image")
    direction: Literal["trace", "retrace"] = Field(description="Sense of the fast axis")
    start_m: PositionVector = Field(description="First point of the line in the AFM frame [m]")
    end_m: PositionVector = Field(description="Last point of the line in the AFM frame [m]")
    height_m: Lengths = Field(description="Height at equal steps along the line [m]")
    amplitude_m: Lengths | None = Field(description="Amplitude of vibration [m]; nil in contact mode")
    phase_rad: Angles | None = Field(description="Phase of vibration [rad]; nil in contact mode")
    lateral_force_n: Forces | None = real.LATERAL_FORCE_N
    torsion_rad: Angles | None = real.TORSION_RAD
    dissipated_j: Energies | None = real.DISSIPATED_J


class LawStatus(Message):
    """State of one half of the law: energy, passivity, and what it receives; energies at the hand's scale."""

    law: str = Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=32, description="Law in force at this half")
    switching: bool = Field(description="The half waits for the other one to take up this law; its device stands still")
    port_energy_j: EnergyJ = Field(description="Energy that has entered the law at this port since it is in force [J]")
    port_power_w: PowerW = Field(description="Power entering at this port, mean since the last report [W]")
    net_valid: bool = Field(description="The energy of the other port is known too")
    net_energy_j: EnergyJ = Field(
        description="Energy that has entered at both ports less what left [J]; stored or lost"
    )
    left_j: EnergyJ = Field(description="Energy reported by the other half and not yet given out [J]; 0 if not counted")
    dissipated_j: EnergyJ = Field(
        description="Energy that the controller has taken out on purpose [J]; 0 if not counted"
    )
    passive: bool = Field(description="Neither the net energy nor the energy left has shown that energy was made")
    saved_percent: Percent = Field(
        description="Signals to the other half that the dead band kept back, since this law is in force [%]"
    )
    heard: bool = Field(description="A signal of the other half in this law has been received")
    silence_s: DurationS = Field(description="Time since the last one [s]; 0 if never received")
    round_trip_valid: bool = Field(description="The round trip was measured; at the master only")
    round_trip_s: DurationS = Field(description="Age of the hand's sample that the newest answer descends from [s]")


class LinkDirection(Record):
    """One direction of the link: the settings in force and what it did since the last report."""

    profile: Text = Field(
        description="Name of the network in force: profile, constant delay, custom, or as in `lte, changed`"
    )
    settings: Facts = Field(description="Settings in force, by dotted key; SI units in the names")
    messages_in: Count = Field(description="Messages taken in since the start")
    messages_out: Count = Field(description="Messages delivered since the start, duplicates included")
    dropped: Counts = Field(description="Messages dropped since the start, by cause")
    duplicated: Count = Field(description="Messages duplicated since the start")
    reordered: Count = Field(description="Messages that overtook an earlier one since the start")
    corrupted: Count = Field(description="Messages corrupted since the start")
    queue_depth: Count = Field(description="Messages in flight now")
    delay_valid: bool = Field(description="At least one message was delivered since the last report")
    delay_mean_s: DurationS = Field(description="Mean delay applied since the last report [s]")
    delay_min_s: DurationS = Field(description="Least delay applied since the last report [s]")
    delay_max_s: DurationS = Field(description="Greatest delay applied since the last report [s]")


class LinkClock(Record):
    """Offset between the clocks of the sites, from four time stamps; figures are 0 when valid is false."""

    valid: bool = Field(description="An exchange with the slave's site was completed")
    offset_s: TimeS = Field(description="What the slave's clock is ahead of the master's [s]")
    uncertainty_s: DurationS = Field(description="Bound of the error of offset_s [s]: half the round trip")
    round_trip_s: DurationS = Field(description="Shortest round trip among the exchanges in view [s]")
    exchanges: Count = Field(description="Number of exchanges in view of the minimum filter")


class LinkStatus(_Extended):
    """The link, both directions."""

    version: ClassVar[int] = 2
    additions: ClassVar[Mapping[str, int]] = {"answer_sent_ns": 2, "answer_received_ns": 2}

    forward: LinkDirection = Field(description="From the master to the slave")
    backward: LinkDirection = Field(description="From the slave to the master")
    clock: LinkClock = Field(description="Offset between the clocks of the sites, past the impairments")
    answer_sent_ns: Count | None = Field(
        default=None, description="t_ns of the newest clock/pong, on the answering clock [ns]; absent before the first"
    )
    answer_received_ns: Count | None = Field(
        default=None, description="When that clock/pong arrived at the link, on the asking clock [ns]"
    )


class LinkDelay(Message):
    """What the way between the sites adds to the age of the hand's samples, from one sample on.

    It is sent before the first message that descends from that sample, whenever the delay changes by a step, and
    with every link/status. With it a reader knows what part of an age is the experiment, and what is a fault.
    """

    direction: Literal["forward", "backward"] = Field(description="forward: from the master to the slave")
    hand_t_ns: Count = Field(description="t_ns of the first haptic/state that it applies to, on its own clock [ns]")
    delay_ns: Count = Field(description="Delay applied on purpose, rounded down to whole milliseconds [ns]")
    transit_ns: Count = Field(
        description="Least time that a message was measured to take between two machines besides [ns]; 0 on one"
    )
    clock_ahead_ns: Annotated[int, Field(ge=-(2**63), le=2**63 - 1)] = Field(
        description="What the slave's clock is ahead of the master's [ns]; 0 where they cannot be told apart"
    )


class LinkFate(Record):
    """Ground truth of one message that reached the link, or of the duplicate that was made of it."""

    topic: Annotated[str, Field(max_length=64)] = Field(description="Topic of the message")
    seq: Count = Field(description="seq of the message")
    is_duplicate: bool = Field(description="This is the duplicate, not the message itself")
    arrived_ns: Count = Field(description="When it reached the link, on the link's clock [ns]")
    delay_ns: Count = Field(description="Delay applied, everything included [ns]; 0 when dropped")
    queue_ns: Count = Field(description="Part of it spent in the queue of a rate limit or delivery trace [ns]")
    held_ns: Count = Field(description="Part of it spent waiting for the end of an outage [ns]")
    dropped: Annotated[str, Field(max_length=64)] = Field(
        description="What dropped it: outage, loss, markov_loss, gilbert_elliott, loss_trace, queue; else empty"
    )
    duplicated: bool = Field(description="A duplicate was made of it")
    reordered: bool = Field(description="It was released before a message of its topic that had arrived earlier")
    corrupted: bool = Field(description="Bits of it were flipped")


class LinkFates(Message):
    """What the link did to each message of one direction since the last such report."""

    direction: Literal["forward", "backward"] = Field(description="forward: from the master to the slave")
    fates: Annotated[tuple[LinkFate, ...], FailFast(), Field(max_length=MAX_ROWS)] = Field(
        description="In the order in which they were decided"
    )


class ClockPing(Message):
    """Question of the link to the other site for its time."""


class ClockPong(Message):
    """Answer to a clock/ping; its own t_ns is the time of sending on the answering clock."""

    ping_t_ns: Count = Field(description="t_ns of the question, on the asking clock [ns]")
    received_ns: Count = Field(description="When the question arrived, on the answering clock [ns]")


class SessionControl(_Extended):
    """A command to the nodes of a session; each node it concerns answers with a session/event of the same id."""

    version: ClassVar[int] = 4
    additions: ClassVar[Mapping[str, int]] = {"validity_s": 2, "node_t_ns": 2, "node_latch": 3, "by": 4}

    id: str = Field(pattern=r"^[A-Za-z0-9_-]{1,64}$", description="Identifier that the answers repeat")
    command: Literal["start", "stop", "arm", "estop", "set", "mark"] = Field(
        description="start or stop the operator's programme; arm the devices; stop at once and latch; "
        "set parameters; mark this moment in the recording"
    )
    target: str = Field(max_length=64, description="Nodes concerned: node@site, node, or *; wildcards as in file names")
    parameters: Facts = Field(description="What the command needs, by dotted key; units in the names")
    validity_s: DurationS | None = Field(
        default=None, description="Time after t_ns for which it may be carried out [s]; 1 s if absent"
    )
    node_t_ns: Counts | None = Field(
        default=None,
        description="By node@site: t_ns of the newest message received from it, on the clock of that node [ns]",
    )
    node_latch: Latches | None = Field(
        default=None,
        description="By node@site: latch in the data of the refusal that this answers, which names the node's run and "
        "counts its emergency stops",
    )
    by: PersonName | None = Field(
        default=None, description="Name of who gave it, where they were given one; the answers repeat it in their data"
    )


class SessionEvent(Message):
    """What happened at a node."""

    id: str = Field(pattern=r"^[A-Za-z0-9_-]{0,64}$", description="Id of the command answered; empty = unasked")
    kind: Literal["ack", "refused", "mode", "link", "network", "node", "recording", "mark", "fault"] = Field(
        description="ack and refused answer a command; mode: a device changed mode; link, network, node, recording: "
        "what became of them; mark: a mark of the operator; fault: something went wrong and was dealt with"
    )
    level: Literal["info", "warning", "error"] = Field(description="How much it matters")
    text: Text = Field(description="One sentence for a person")
    data: Facts = Field(description="The same for a program; units in the names")


class InputHealth(Record):
    """What a node knows of one topic from one source."""

    topic: Text = Field(description="Topic")
    src: Text = Field(description="Publisher, node@site; empty when nothing was ever received")
    received: Count = Field(description="Messages accepted since the start")
    lost: Count = Field(description="Messages missing by sequence gaps since the start")
    gaps: Count = Field(description="Sequence gaps since the start")
    repeated: Count = Field(description="Messages that came twice or out of order since the start")
    restarts: Count = Field(description="Restarts of the publisher seen since the start")
    age_valid: bool = Field(description="At least one message was received")
    age_s: TimeS = Field(description="Time since the publisher sent the newest message [s], across two clocks")


class NodeHealth(_Extended):
    """How a process is doing."""

    version: ClassVar[int] = 2
    additions: ClassVar[Mapping[str, int]] = {"device_latency_s": 2, "device_age_s": 2, "calibration": 2}

    pid: Count = Field(description="Process id")
    state: Literal["starting", "ready", "running", "safe", "stopping"] = Field(description="What the node is at")
    uptime_s: DurationS = Field(description="Time since the node started [s]")
    rate_hz: RateHz = Field(description="Steps a second since the last report")
    period_s: DurationS = Field(description="Nominal period of the loop [s]; 0 = acts on messages only")
    lateness_p50_s: DurationS = Field(description="Median lateness against the deadline since the last report [s]")
    lateness_p99_s: DurationS = Field(description="99 % lateness since the last report [s]")
    lateness_max_s: DurationS = Field(description="Greatest lateness since the last report [s]")
    overruns: Count = Field(description="Deadlines missed by a period or more since the start")
    rejected: Counts = Field(
        description="Frames and connections refused since the start, by reason; superseded: a newer message of a "
        "latest topic was waiting as well; stale: older than the deadline of its topic"
    )
    cpu_percent: Percent = Field(description="Processor time used since the last report [% of one core]")
    memory_bytes: Count = Field(description="Resident memory [bytes]")
    realtime: bool = Field(description="SCHED_FIFO is in force")
    memory_locked: bool = Field(description="Memory is locked")
    replay: bool = Field(description="The messages of this node come from a recording, not from an instrument")
    inputs: Annotated[tuple[InputHealth, ...], FailFast()] = Field(
        max_length=MAX_ROWS, description="Every input of the node; of many sources, those that sent most"
    )
    device_latency_s: DurationS | None = real.LATENCY_S
    device_age_s: DurationS | None = real.MEAN_AGE_S
    calibration: str | None = real.CALIBRATION

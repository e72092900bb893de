"""What `set` takes at the instrument: a program to begin or to change, and where the tip is over the sample."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from proto.errors import ConfigError, RefusedError
from proto.messages import Scalar
from services.afm_node.physics.disturbances import DisturbanceConfig
from services.runtime.settings.config import Settings, merge, nested, validate

Length = Annotated[float, Field(ge=1e-9, le=1e-3)]
Place = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Speed = Annotated[float, Field(gt=0.0, le=1e-3)]
Force = Annotated[float, Field(gt=-1e-3, le=1e-3)]


class ScanSettings(Settings):
    """An image with a constant force, or with a constant amplitude of a vibrating tip."""

    mode: Literal["contact", "tapping"] = Field(
        "contact", description="contact: the force is held; tapping: the amplitude, with afm_node.model dynamic."
    )
    width_m: Length | None = Field(None, description="Length of a line [m]; default: the whole sample.")
    depth_m: Length | None = Field(None, description="From the first line to the last [m]; default: the whole sample.")
    x_m: Place = Field(0.0, description="Middle of the image [m]; 0 is the middle of the sample.")
    y_m: Place = Field(0.0, description="Middle of the image [m]; 0 is the middle of the sample.")
    pixels: int = Field(64, ge=2, le=4096, description="Pixels of a line, 2 to 4096.")
    lines: int = Field(64, ge=1, le=4096, description="Lines, 1 to 4096.")
    dwell_s: float = Field(4e-3, ge=1e-3, le=10.0, description="Time on each pixel, each way [s], 0.001 to 10.")
    setpoint_n: Force = Field(5e-9, description="Force that is held in contact mode [N].")
    amplitude_m: Length = Field(20e-9, description="Amplitude without a sample, in tapping mode [m].")
    setpoint_share: float = Field(0.8, ge=0.05, lt=1.0, description="Share of it that is held, 0.05 to below 1.")
    gain_per_s: float = Field(400.0, gt=0.0, le=1e5, description="Integral gain of the feedback [1/s].")
    proportional: float = Field(0.0, ge=0.0, le=100.0, description="Proportional gain of the feedback, no unit.")
    approach_m_per_s: Speed = Field(100e-9, description="Speed of the approach [m/s].")
    settle_s: float = Field(0.2, ge=0.0, le=60.0, description="Time for the force to settle before the first line [s].")


class CurveSettings(Settings):
    """A force curve where the tip is."""

    start_m: Length = Field(20e-9, description="Way above the rest point at which it begins and ends [m].")
    load_n: Force = Field(20e-9, description="Force at which it turns [N].")
    speed_m_per_s: Speed = Field(50e-9, description="Speed of the base [m/s].")


class TactileSettings(Settings):
    """A path that a hand feels."""

    drive: Literal["line", "pointer"] = Field(
        "line", description="line: from x0, y0 to x1, y1; pointer: wherever lateral.x_m and lateral.y_m lead."
    )
    x0_m: Place = Field(0.0, description="Begin of the line [m], or where the pointer takes over.")
    y0_m: Place = Field(0.0, description="Begin of the line [m], or where the pointer takes over.")
    x1_m: Place | None = Field(None, description="End of the line [m]; default: half the sample further.")
    y1_m: Place | None = Field(None, description="End of the line [m]; default: as y0_m.")
    speed_m_per_s: Speed = Field(30e-9, description="Speed of the tip [m/s], limited by the two below (Eq. 14).")
    feature_m: Length = Field(1e-9, description="Least length of a feature that is to be felt, dL [m].")
    bandwidth_hz: float = Field(30.0, gt=0.0, le=1e5, description="Bandwidth of the operator's device, f_m [Hz].")
    setpoint_n: Force = Field(5e-9, description="Force with which the tip touches the first point [N].")
    hold: Literal["height", "force"] = Field(
        "height", description="height: the base stands, the deflection is the height; force: a feedback holds it."
    )
    gain_per_s: float = Field(400.0, gt=0.0, le=1e5, description="Gain of that feedback [1/s].")
    approach_m_per_s: Speed = Field(100e-9, description="Speed of the approach [m/s].")


class LateralTarget(Settings):
    """Where the tip is to be over the sample while no program runs; what a hand commands is added."""

    x_m: Place | None = Field(None, description="Along x [m]; 0 is the middle of the sample.")
    y_m: Place | None = Field(None, description="Along y [m]; 0 is the middle of the sample.")


class InstrumentRequest(Settings):
    """All keys that `set` takes at the AFM."""

    program: Literal["scan", "curve", "tactile", "pause", "resume", "abort"] | None = Field(
        None,
        description="scan, curve, tactile: begin; pause, resume: the one that runs; abort: end it, and retract.",
    )
    scan: ScanSettings = Field(ScanSettings(), description="What is imaged.")
    curve: CurveSettings = Field(CurveSettings(), description="The force curve.")
    tactile: TactileSettings = Field(TactileSettings(), description="The path that a hand feels.")
    lateral: LateralTarget = Field(LateralTarget(), description="Where the tip is to be.")


def requested(parameters: Mapping[str, Scalar], others: Mapping[str, Scalar] | None = None) -> InstrumentRequest:
    """Return what parameters by dotted key ask for; RefusedError says what is wrong with them, or that there are none.

    Parameters: others, keys of the same command that are for somebody else.
    """
    try:
        request = validate(InstrumentRequest, nested(parameters, "session/control"), "session/control", "afm_node")
    except ConfigError as error:
        raise RefusedError(str(error)) from error
    sections = {key.partition(".")[0] for key in parameters}
    if idle := sections & {"scan", "curve", "tactile"} - {request.program}:
        raise RefusedError(f"{', '.join(sorted(idle))}: takes effect with program={min(idle)} in the same command only")
    if not sections and not others:
        raise RefusedError("set needs parameters, such as program=scan or lateral.x_m=2e-8")
    return request


def changed_disturbances(config: DisturbanceConfig, parameters: Mapping[str, Scalar]) -> DisturbanceConfig:
    """Return disturbances with keys `disturbances.…` changed; RefusedError says what is wrong with them."""
    try:
        document = merge({"disturbances": config.model_dump()}, nested(parameters, "session/control"))
        section = document["disturbances"]
        return validate(DisturbanceConfig, section, "session/control", "afm_node.disturbances")
    except ConfigError as error:
        raise RefusedError(str(error)) from error

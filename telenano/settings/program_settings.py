"""Settings of the programs of the instrument: their common base, and those of the programs of this project."""

from typing import Annotated, Literal

from pydantic import Field

from telenano.settings.config import Settings

Length = Annotated[float, Field(ge=1e-9, le=1e-3)]
Position = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Speed = Annotated[float, Field(gt=0.0, le=1e-3)]
Force = Annotated[float, Field(gt=-1e-3, le=1e-3)]


# A pixel lasts at least so many steps of the instrument.
PIXEL_STEPS = 2
# The time on a pixel where none is given and it has enough steps [s].
_DWELL_S = 4e-3


class ProgramSettings(Settings):
    """Settings of a program."""


class ScanSettings(ProgramSettings):
    """An image with a constant force, or with a constant amplitude of a vibrating tip."""

    mode: Literal["contact", "tapping"] = Field(
        "contact",
        description="contact: the force is held; tapping: the amplitude, which needs afm_node.model dynamic.",
    )
    width_m: Length | None = Field(None, description="Length of a line [m]; default: the whole sample.")
    depth_m: Length | None = Field(
        None, description="Distance from the first line to the last [m]; default: the whole sample."
    )
    x_m: Position = Field(0.0, description="Middle of the image [m]; 0 is the middle of the sample.")
    y_m: Position = Field(0.0, description="Middle of the image [m]; 0 is the middle of the sample.")
    pixels: int = Field(64, ge=2, le=4096, description="Pixels of a line.")
    lines: int = Field(64, ge=1, le=4096, description="Lines of the image.")
    dwell_s: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        None,
        description=f"Time on each pixel, each way [s]; default: {1e3 * _DWELL_S:g} ms, or {PIXEL_STEPS} steps of a"
        " slow instrument.",
    )
    setpoint_n: Force = Field(5e-9, description="Force that is held in contact mode [N].")
    amplitude_m: float = Field(20e-9, ge=1e-12, le=1e-3, description="Amplitude without a sample, in tapping mode [m].")
    setpoint_share: float = Field(0.8, ge=0.05, lt=1.0, description="Share of that amplitude that is held.")
    gain_per_s: float = Field(400.0, gt=0.0, le=1e7, description="Integral gain of the feedback [1/s].")
    proportional: float = Field(0.0, ge=0.0, le=100.0, description="Proportional gain of the feedback, no unit.")
    approach_m_per_s: Speed = Field(100e-9, description="Speed of the approach [m/s].")
    settle_s: float = Field(0.2, ge=0.0, le=60.0, description="Time for the force to settle before the first line [s].")

    def pixel_s(self, period_s: float = 0.0) -> float:
        """Return the time on each pixel, each way [s]: as given, or what fits an instrument with this period [s].

        An instrument that takes the image by its own scan counts no steps of the program, and has no period here.

        >>> ScanSettings().pixel_s(1e-3), ScanSettings().pixel_s(4e-3), ScanSettings(dwell_s=3e-3).pixel_s(4e-3)
        (0.004, 0.008, 0.003)
        """
        return max(_DWELL_S, PIXEL_STEPS * period_s) if self.dwell_s is None else self.dwell_s

    @property
    def free_amplitude_m(self) -> float:
        """The amplitude without a sample [m]; 0 in contact mode."""
        return self.amplitude_m if self.mode == "tapping" else 0.0


class CurveSettings(ProgramSettings):
    """A force curve at the present place of the tip."""

    start_m: float = Field(
        20e-9, ge=1e-12, le=1e-3, description="Distance above the rest point at which the curve begins and ends [m]."
    )
    load_n: Force = Field(20e-9, description="Force at which the base turns back [N].")
    speed_m_per_s: Speed = Field(50e-9, description="Speed of the base [m/s].")


class TactileSettings(ProgramSettings):
    """A path that a hand feels."""

    drive: Literal["line", "pointer"] = Field(
        "line", description="line: from x0, y0 to x1, y1; pointer: wherever lateral.x_m and lateral.y_m lead."
    )
    x0_m: Position = Field(0.0, description="Start of the line [m], or the place at which the pointer takes over.")
    y0_m: Position = Field(0.0, description="Start of the line [m], or the place at which the pointer takes over.")
    x1_m: Position | None = Field(None, description="End of the line [m]; default: half the sample further.")
    y1_m: Position | None = Field(None, description="End of the line [m]; default: as y0_m.")
    speed_m_per_s: Speed = Field(30e-9, description="Speed of the tip [m/s], limited by the two keys below (Eq. 14).")
    feature_m: Length = Field(1e-9, description="Least length of a feature that is to be felt, dL [m].")
    bandwidth_hz: float = Field(30.0, gt=0.0, le=1e5, description="Bandwidth of the operator's device, f_m [Hz].")
    setpoint_n: Force = Field(5e-9, description="Force with which the tip touches the first point [N].")
    hold: Literal["height", "force"] = Field(
        "height",
        description="height: the base stands still, and the deflection is the height; force: a feedback holds the "
        "force.",
    )
    gain_per_s: float = Field(400.0, gt=0.0, le=1e5, description="Gain of that feedback [1/s].")
    approach_m_per_s: Speed = Field(100e-9, description="Speed of the approach [m/s].")

    @property
    def felt_speed_m_per_s(self) -> float:
        """The fastest motion of the tip at which its features are felt [m/s] (Eq. 14).

        >>> round(TactileSettings(feature_m=1e-9, bandwidth_hz=30.0).felt_speed_m_per_s * 1e9, 9)  # nm/s
        30.0
        """
        return self.feature_m * self.bandwidth_hz

"""Section `afm_node.disturbances`: noise, drift and other disturbances of a simulated AFM.

`telenano.afm.disturbances` has their models.
"""

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from telenano.settings.config import Settings, validate
from telenano.settings.named_instruments import IDEAL, instrument_named
from telenano.wire.errors import ConfigError


class VibrationConfig(Settings):
    """Vibration of the base."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    rms_m: float = Field(0.1e-9, ge=0.0, le=1e-6, description="Root mean square [m].")
    low_hz: float = Field(1.0, gt=0.0, le=1e5, description="Lowest frequency [Hz].")
    high_hz: float = Field(400.0, gt=0.0, le=1e5, description="Highest frequency [Hz]; the paper has 1 Hz to 10 kHz.")


class HysteresisConfig(Settings):
    """Hysteresis of the piezo."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    share: float = Field(
        0.1, ge=0.0, le=0.2, description="Width of a loop over the whole range, as a share of that range."
    )
    range_m: float = Field(100e-9, gt=0.0, le=1e-3, description="Range over which the play operators are spread [m].")


class CreepConfig(Settings):
    """Creep of the piezo."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    share_per_decade: float = Field(
        0.02, ge=0.0, le=0.5, description="Share of a step that follows per decade of time."
    )


class StageConfig(Settings):
    """First resonance of the stage, or the bandwidth of its drive."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    resonance_hz: float = Field(200.0, ge=1.0, le=1e5, description="Undamped resonance w / 2 pi [Hz].")
    damping: float = Field(
        0.7071,
        gt=0.0,
        lt=1.0,
        description="Damping ratio d, below 1; 0.7071 is -3 dB at the resonance, an open-loop scanner has some 0.01.",
    )


class DriftConfig(Settings):
    """Thermal drift of the distance, and of the sample under the stage."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    speed_m_per_s: float = Field(0.05e-9, ge=-1e-6, le=1e-6, description="Speed of the base towards the sample [m/s].")
    x_m_per_s: float = Field(0.0, ge=-1e-6, le=1e-6, description="Speed at which the sample drifts along x [m/s].")
    y_m_per_s: float = Field(0.0, ge=-1e-6, le=1e-6, description="Speed at which the sample drifts along y [m/s].")
    walk_m2_per_s3: float = Field(
        0.0,
        ge=0.0,
        le=1e-18,
        description="Density of the white acceleration by which the sample's speeds along x and y wander [m^2/s^3].",
    )
    wander_m_per_s: float = Field(
        0.0, ge=0.0, le=1e-6, description="Root mean square of the speed by which the base wanders in z as well [m/s]."
    )
    wander_s: float = Field(60.0, ge=0.01, le=1e5, description="Correlation time of that speed [s].")


class ThermalConfig(Settings):
    """Thermal noise of the cantilever."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    temperature_k: float = Field(300.0, ge=0.0, le=2000.0, description="Temperature [K].")


class ReadoutConfig(Settings):
    """Noise of the bridge (Eq. 3) and its converter."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    white_v: float = Field(0.5e-3, ge=0.0, le=1.0, description="White noise, root mean square of a sample [V].")
    flicker_v: float = Field(0.5e-3, ge=0.0, le=1.0, description="1/f noise, root mean square over its octaves [V].")
    converter_bits: int = Field(16, ge=4, le=32, description="Bits of the converter.")
    converter_range_v: float = Field(10.0, gt=0.0, le=1e3, description="Range of the converter, either way [V].")


class ElectrostaticConfig(Settings):
    """Voltage between tip and sample: contact potential, charges, or a bias; the force is that of `electrostatic`."""

    enabled: bool = Field(False, description="Whether the disturbance acts.")
    voltage_v: float = Field(1.0, ge=-100.0, le=100.0, description="Mean voltage [V].")
    noise_v: float = Field(0.0, ge=0.0, le=100.0, description="Root mean square of the voltage's wandering [V].")
    correlation_s: float = Field(1.0, gt=0.0, le=1e4, description="Correlation time of that wandering [s].")


class DisturbanceConfig(Settings):
    """Section `afm_node.disturbances`."""

    seed: int = Field(0, ge=0, lt=2**63, description="Seed of all random disturbances.")
    vibration: VibrationConfig = Field(VibrationConfig(), description="Vibration of the base.")
    hysteresis: HysteresisConfig = Field(HysteresisConfig(), description="Hysteresis of the piezo.")
    creep: CreepConfig = Field(CreepConfig(), description="Creep of the piezo.")
    stage: StageConfig = Field(StageConfig(), description="Lag of the stage.")
    drift: DriftConfig = Field(DriftConfig(), description="Thermal drift.")
    thermal: ThermalConfig = Field(ThermalConfig(), description="Thermal noise of the cantilever.")
    readout: ReadoutConfig = Field(ReadoutConfig(), description="Noise of the read-out.")
    electrostatic: ElectrostaticConfig = Field(ElectrostaticConfig(), description="Force of a voltage at the tip.")

    @property
    def any_enabled(self) -> bool:
        base = self.vibration.enabled or self.hysteresis.enabled or self.creep.enabled or self.stage.enabled
        return base or self.drift.enabled or self.thermal.enabled or self.readout.enabled or self.electrostatic.enabled


def instrument_name(name: str, section: Mapping[str, Any]) -> str:
    """Return the name under which a session records its instrument.

    Args:
        name: The instrument that the scenario names.
        section: Section `afm_node` of the scenario, merged over the keys of its instrument.

    Returns:
        The name, followed by ", changed" where the disturbances differ from the instrument's own in more than their
        seed; "disturbed" where they differ from those of the ideal instrument; the driver's name for an instrument that
        is not simulated.

    Raises:
        ConfigError: The section cannot be read; the message names the key.
    """
    driver = str(section.get("driver", "simulated"))
    if driver != "simulated":
        return driver
    try:
        own = instrument_named(name).scenario.get("afm_node", {}).get("disturbances", {})
    except ConfigError:
        # A recording from elsewhere may name an instrument that is unknown here.
        return name
    there, here = (
        validate(DisturbanceConfig, {**section_of_part, "seed": 0}, "scenario", "afm_node.disturbances")
        for section_of_part in (own, section.get("disturbances", {}))
    )
    if here == there or not (here.any_enabled or there.any_enabled):
        return name
    return "disturbed" if name == IDEAL else f"{name}, changed"

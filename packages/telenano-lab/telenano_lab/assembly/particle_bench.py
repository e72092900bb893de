"""The instrument on which particles are pushed: a flat sample, and a base that clears the highest particle."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from telenano.settings import flag_overrides, merge, validate

if TYPE_CHECKING:
    from telenano.sections import AfmConfig
    from telenano_lab.assembly.particles.settings import ParticlesConfig

# A thermal drift of 0.05 nm/s and noise of the read-out.
DISTURBED: dict[str, Any] = {
    "drift": {"enabled": True, "speed_m_per_s": 0.0, "x_m_per_s": 4e-11, "y_m_per_s": -3e-11},
    "readout": {"enabled": True},
}


def bench(particles: dict[str, Any], stiffness_n_per_m: float = 0.1, **others: Any) -> dict[str, Any]:
    """Return a section `afm_node` for particles.

    Args:
        particles: The section `sample.particles`.
        stiffness_n_per_m: Spring constant of the cantilever [N/m]; 0.1 is soft enough to image in contact without
            moving a particle.
        others: Further keys of the section.
    """
    return {
        "sample": {"name": "flat", "size_m": 8e-6, "pixels": 16, "particles": particles},
        "cantilever": {"stiffness_n_per_m": stiffness_n_per_m},
        "meniscus": False,
        "safety": {
            "base_min_m": -1.2e-6,
            "retract_position_m": -0.7e-6,
            "base_max_m": 3e-7,
            "base_speed_m_per_s": 2e-5,
            "retract_speed_m_per_s": 2e-5,
        },
        **others,
    }


def configured(
    settings: Sequence[str], particles: dict[str, Any], disturbances: dict[str, Any], *elsewhere: str
) -> "AfmConfig":
    """Return the disturbed bench, modified by the options `--afm`.

    Args:
        settings: The text of each option, such as `sample.particles.count=3`.
        particles: The section `sample.particles`, unless an option sets a key of `elsewhere` in it.
        disturbances: The section `disturbances`.
        elsewhere: Keys of `sample.particles`.

    Raises:
        ConfigError: An option is wrong; the message names it.
    """
    from telenano.sections import AfmConfig

    overrides = flag_overrides(settings)
    lie_elsewhere = overrides.get("sample", {}).get("particles", {}).keys() & set(elsewhere)
    document = bench({} if lie_elsewhere else particles, disturbances=disturbances)
    return validate(AfmConfig, merge(document, overrides), "--afm")


def particles_of(config: "AfmConfig") -> "ParticlesConfig | None":
    """Return the particles on the sample of a configuration; None without any."""
    particles: ParticlesConfig | None = None if config.sample is None else config.sample.layer("particles")
    return particles

"""Assemblies over many seeds, with noise, drift and a tip on a cone; images that move particles and that do not."""

import math
from typing import Any

import pytest
from telenano_lab.assembly.assemble_command import _config
from telenano_lab.assembly.patterns import pattern
from telenano_lab.assembly.run import Assembler, VirtualBench

from telenano.sections import AfmConfig
from telenano.settings import merge, validate

# Five assemblies take three minutes of a processor, which a busy machine gives in many.
pytestmark = [pytest.mark.endurance, pytest.mark.timeout(3600)]


def assembled(name: str, seed: int) -> tuple[int, int]:
    """Return how many particles of a pattern lie within 50 nm of their target in truth, and how many there are."""
    config = _config(seed, [])
    targets = pattern(name, 8 if name == "square" else 6, 1e-6)
    bench = VirtualBench(config)
    Assembler(bench, config, targets, config.sample_sides_m()).run()
    return sum(min(math.dist(target, place) for place in bench.truth()) <= 50e-9 for target in targets), len(targets)


@pytest.mark.parametrize("first", range(0, 20, 5))
@pytest.mark.parametrize("name", ["square", "line"])
def test_assemblies_place_their_particles_over_twenty_seeds(name: str, first: int) -> None:
    """Five seeds a test, so that workers share them; each five have to reach the share of all twenty."""
    placed, wanted = (sum(counts) for counts in zip(*(assembled(name, first + n) for n in range(5)), strict=True))
    assert placed >= 0.95 * wanted


def _imaged(seed: int, scan: dict[str, Any], **others: Any) -> list[float]:
    """Return how far an image has moved each particle [m]."""
    config: AfmConfig = _config(seed, [])
    section = merge(
        config.model_dump(exclude_unset=True), {"sample": {"size_m": 3.4e-6, "particles": {"count": 2}}}, others
    )
    bench = VirtualBench(validate(AfmConfig, section, "a test", "afm_node"))
    before = bench.truth()
    keys = {
        "program": "scan",
        "scan.pixels": 24,
        "scan.lines": 18,
        "scan.dwell_s": 70e-3,
        "scan.approach_m_per_s": 5e-6,
    }
    for _ in bench.lines(keys | scan):
        pass
    return [math.dist(a, b) for a, b in zip(before, bench.truth(), strict=True)]


@pytest.mark.parametrize("seed", range(20))
def test_a_careless_image_in_contact_moves_each_particle_that_it_passes(seed: int) -> None:
    assert min(_imaged(seed, {"scan.mode": "contact", "scan.setpoint_n": 10e-9, "scan.dwell_s": 35e-3})) > 100e-9


@pytest.mark.parametrize("seed", range(20))
def test_a_light_image_in_contact_moves_none(seed: int) -> None:
    assert max(_imaged(seed, {"scan.mode": "contact", "scan.setpoint_n": 1.5e-9})) < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_an_image_in_tapping_moves_none(seed: int) -> None:
    stiff = {"cantilever": {"stiffness_n_per_m": 40.0}, "model": "dynamic"}
    assert max(_imaged(seed, {"scan.mode": "tapping", "scan.dwell_s": 8e-3}, **stiff)) < 1e-9

"""Assemblies over many seeds, with noise, drift and a tip on a cone; images that move particles and that do not."""

import math
from typing import Any

import pytest

from services.afm_node.config import AfmConfig
from services.runtime.settings.config import merge, validate
from studies.assembly.patterns import pattern
from studies.assembly.run import Assembler, VirtualBench
from telenano.cli.commands.assemble import _config

pytestmark = pytest.mark.endurance


@pytest.mark.parametrize("name", ["square", "line"])
def test_an_assembly_places_its_particles_over_twenty_seeds(name: str) -> None:
    placed = wanted = 0
    for seed in range(20):
        config = _config(seed, [])
        targets = pattern(name, 8 if name == "square" else 6, 1e-6)
        bench = VirtualBench(config)
        Assembler(bench, config, targets, config.sample_sides_m()).run()
        wanted += len(targets)
        placed += sum(min(math.dist(target, place) for place in bench.truth()) <= 50e-9 for target in targets)
    assert placed >= 0.95 * wanted


def _imaged(seed: int, scan: dict[str, Any], **others: Any) -> list[float]:
    """Return how far an image has moved each particle [m]."""
    config: AfmConfig = _config(seed, [])
    section = merge(
        config.model_dump(exclude_unset=True), {"sample": {"size_m": 4e-6, "particles": {"count": 3}}}, others
    )
    bench = VirtualBench(validate(AfmConfig, section, "a test", "afm_node"))
    before = bench.truth()
    keys = {
        "program": "scan",
        "scan.pixels": 32,
        "scan.lines": 24,
        "scan.dwell_s": 62.5e-3,
        "scan.approach_m_per_s": 5e-6,
    }
    for _ in bench.lines(keys | scan):
        pass
    return [math.dist(a, b) for a, b in zip(before, bench.truth(), strict=True)]


@pytest.mark.parametrize("seed", range(20))
def test_a_careless_image_in_contact_moves_particles(seed: int) -> None:
    assert max(_imaged(seed, {"scan.mode": "contact", "scan.setpoint_n": 10e-9})) > 100e-9


@pytest.mark.parametrize("seed", range(20))
def test_a_light_image_in_contact_moves_none(seed: int) -> None:
    assert max(_imaged(seed, {"scan.mode": "contact", "scan.setpoint_n": 1.5e-9})) < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_an_image_in_tapping_moves_none(seed: int) -> None:
    stiff = {"cantilever": {"stiffness_n_per_m": 40.0}, "model": "dynamic"}
    assert max(_imaged(seed, {"scan.mode": "tapping", "scan.dwell_s": 20e-3}, **stiff)) < 1e-9

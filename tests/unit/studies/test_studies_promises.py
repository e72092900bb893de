"""The promise of docs/laws.md over bad links: passivity control holds every spring and makes no energy."""

import pytest

from studies.cells import Cell, Hand, run_cell

SEEDS = range(25)
LINKS = ((60.0, 15.0, 0.5), (200.0, 50.0, 0.2), (500.0, 125.0, 0.2))


def held(law: str, stiffness: float, link: tuple[float, float, float], hand: Hand, seed: int) -> float:
    """Run a cell that has to be stable, and give the least energy at the device [J]."""
    round_trip_ms, jitter_ms, loss = link
    result = run_cell(
        Cell(
            law=law,
            environment="spring",
            stiffness_n_per_m=stiffness,
            hand=hand,
            round_trip_ms=round_trip_ms,
            jitter_ms=jitter_ms,
            loss=loss,
            seed=seed,
        )
    )
    assert result.verdict == "stable", (seed, result.reason)
    return result.lowest_energy_j


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.parametrize("stiffness", [5.0, 38.0, 80.0, 200.0])
@pytest.mark.parametrize("link", LINKS, ids=lambda link: f"{link[0]:g}ms")
def test_passivity_holds_and_makes_no_energy_at_the_device(stiffness: float, link: tuple[float, float, float]) -> None:
    hands: tuple[Hand, ...] = ("force", "ordinary")
    assert min(held("passivity", stiffness, link, hand, seed) for hand in hands for seed in SEEDS) >= -1e-6

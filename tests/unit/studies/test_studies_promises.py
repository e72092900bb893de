"""The promise of docs/laws.md over bad links: passivity control holds every spring and makes no energy."""

import pytest

from studies import lockstep
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


def test_waves_keep_hand_and_tip_together_over_a_link_with_jitter(monkeypatch: pytest.MonkeyPatch) -> None:
    # without the compiler: the law need not be compiled into the loop
    monkeypatch.setattr(lockstep, "_run", getattr(lockstep._run, "py_func", lockstep._run))
    held = run_cell(
        Cell(
            law="wave",
            environment="spring",
            stiffness_n_per_m=20.0,
            round_trip_ms=60.0,
            jitter_ms=15.0,
            seed=1,
            session_s=4.0,
        )
    )
    assert held.tip_n == pytest.approx(1.0, rel=0.03, abs=0.0)
    # F (T + tau_f)/b is 0.5 mm; a half that steps too few periods lets the hand walk by more than 1 mm/s
    assert held.apart_m is not None
    assert 0.0 < held.apart_m < 1e-3
    assert held.lowest_energy_j >= -1e-6


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.parametrize("stiffness", [5.0, 38.0, 80.0, 200.0])
@pytest.mark.parametrize("link", LINKS, ids=lambda link: f"{link[0]:g}ms")
def test_passivity_holds_and_makes_no_energy_at_the_device(stiffness: float, link: tuple[float, float, float]) -> None:
    hands: tuple[Hand, ...] = ("force", "ordinary")
    assert min(held("passivity", stiffness, link, hand, seed) for hand in hands for seed in SEEDS) >= -1e-6

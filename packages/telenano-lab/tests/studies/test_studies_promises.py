"""The promises of docs/passivity.md over bad links: which law makes no energy there, and which holds every sample."""

import re
from itertools import cycle, product
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from answered_sweep import Answered
from telenano_lab.studies.loops.cells import Cell, Hand, course_of, energies_of, run_cell, scales_of
from telenano_lab.studies.loops.promises import (
    BURST_LOSSES,
    HANDS,
    LOSSES,
    PASSIVE_LAWS,
    ROUND_TRIPS_MS,
    SAMPLES,
    UNEVEN,
    UNEVEN_MS,
    broken,
    drawn_cells,
    outcomes,
)
from telenano_lab.studies.loops.sweep import Journal, Sweep

from telenano.afm import MODE_HOLD

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


def test_waves_keep_hand_and_tip_together_over_a_link_with_jitter(plain_loop: None) -> None:
    # The loop runs without the compiler, which would take longer over the law than the run does.
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


def test_drawn_links_cover_what_is_promised_and_are_the_same_for_every_law() -> None:
    cells = drawn_cells(["wave"], 50)
    assert cells == drawn_cells(["wave"], 50)
    assert [cell for cell in drawn_cells(PASSIVE_LAWS, 50) if cell.law == "wave"] == cells
    assert {cell.round_trip_ms for cell in cells} == set(ROUND_TRIPS_MS)
    assert {(cell.round_trip_ms, cell.loss) for cell in cells} == set(product(ROUND_TRIPS_MS, LOSSES))
    assert {cell.hand for cell in cells} == set(HANDS)
    assert {(cell.environment, cell.stiffness_n_per_m) for cell in cells} == set(SAMPLES)
    assert {cell.jitter_ms / cell.round_trip_ms for cell in cells if cell.round_trip_ms} == {0.25}
    assert {cell.seed for cell in cells} == set(range(50))
    in_bursts = drawn_cells(["wave"], 50, 40.0)
    assert {(cell.round_trip_ms, cell.loss) for cell in in_bursts} == set(product(ROUND_TRIPS_MS, BURST_LOSSES))
    assert {cell.burst for cell in in_bursts} == {40.0}
    assert [(cell.hand, cell.environment) for cell in in_bursts] == [(cell.hand, cell.environment) for cell in cells]


def test_drawn_uneven_links_are_of_every_kind_and_size() -> None:
    cells = drawn_cells(["wave"], 48, uneven=True)
    assert {(cell.round_trip_ms, cell.uneven) for cell in cells} == set(product(ROUND_TRIPS_MS, UNEVEN))
    assert {cell.uneven_ms for cell in cells} == set(UNEVEN_MS)
    assert {(cell.jitter_ms, cell.loss, cell.burst) for cell in cells} == {(0.0, 0.0, None)}


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.timeout(1200)
def test_over_drawn_uneven_links_no_energy_is_made_at_the_device(tmp_path: Path) -> None:
    rows = outcomes(PASSIVE_LAWS, 24, Sweep(Journal(tmp_path / "journal.jsonl"), 1), uneven=True)
    assert sum(row.runs for row in rows) == 24 * len(SAMPLES) * len(PASSIVE_LAWS)
    assert broken(rows) == []


@pytest.mark.parametrize("kind", UNEVEN)
def test_one_cell_over_each_uneven_link_makes_no_energy(kind: Any) -> None:
    cell = Cell(
        law="wave", environment="spring", stiffness_n_per_m=80.0, round_trip_ms=20.0, uneven=kind, uneven_ms=60.0
    )
    result = run_cell(cell.model_copy(update={"session_s": 3.0}))
    assert result.lowest_energy_j >= -1e-6
    # in each slot the instrument holds its base for a moment, which costs some force (the next test)
    rests_n, within_n = (0.945, 0.005) if kind == "slots" else (1.0, 0.05)
    assert result.tip_n == pytest.approx(rests_n, abs=within_n)


@pytest.mark.check("sessions of nine seconds over slots")
@pytest.mark.parametrize("stiffness", [40.0, 80.0, 150.0])
def test_wave_over_slots_rests_or_pays_for_the_holds_of_the_instrument(stiffness: float) -> None:
    """What the hand works at rest is what the holds take: 3.5 uJ for each, whatever the sample (docs/passivity.md)."""
    line: dict[str, Any] = {"round_trip_ms": 20.0, "uneven": "slots", "session_s": 9.0}
    worked, held, pressed = [], [], []
    for slot_ms in (48.0, 60.0):
        cell = Cell(law="wave", environment="spring", stiffness_n_per_m=stiffness, uneven_ms=slot_ms, **line)
        course = course_of(cell, cell.hand_points(), 9.0)
        late = course.time_s >= 7.0
        stored_j = energies_of(course, scales_of(cell.controller())).stored_j[late]
        worked.append(float(stored_j[-1] - stored_j[0]))
        holds = course.instrument_mode[late] == MODE_HOLD
        held.append(int((holds[1:] & ~holds[:-1]).sum()))
        pressed.append(scales_of(cell.controller()).force_scale * float(course.tip_force_n[late].mean()))
    assert (held[0], pressed[0]) == (0, pytest.approx(1.0, abs=0.01))
    assert worked[1] == pytest.approx(3.5e-6 * held[1], rel=0.1, abs=0.0)
    assert pressed[1] == pytest.approx(0.968, abs=0.005)


def ending(*ends: tuple[str, float, float]) -> Answered:
    """Return a sweep whose runs end with these in turn: verdict, least energy [J], force at the tip [N]."""
    turns = cycle({"verdict": verdict, "lowest_energy_j": least_j, "tip_n": tip_n} for verdict, least_j, tip_n in ends)
    return Answered(lambda _: {"peak_n": 1.0, "hand_n": 1.0, "apart_m": 1e-3, **next(turns)})


def test_a_law_that_promises_passivity_and_makes_energy_is_named() -> None:
    for energy_j, fails in ((-0.9e-6, False), (-1.1e-6, True)):
        sweep = ending(("stable", energy_j, 0.5), ("drifting", 0.0, 9.0))
        rows = outcomes(["wave"], 5, sweep)
        assert bool(broken(rows)) is fails
        assert sum(row.runs for row in rows) == 5 * len(SAMPLES)
        assert sum(row.stable for row in rows) == sum(row.failed.get("drifting", 0) for row in rows) == 15
        assert min(row.lowest_energy_j for row in rows) == energy_j
        # what was not stable has no force to speak of
        assert {row.share for row in rows if row.stable} <= {0.5, 0.25, 0.375}
    assert broken(outcomes(["position_force"], 5, ending(("diverged", -1.0, 1.0)))) == []


DOCUMENT = (Path(__file__).parents[2] / "docs" / "study-results.md").read_text(encoding="utf-8")
PRINTED_HANDS: dict[str, Hand] = {"constant force": "force", "arm of 300 N/m": "ordinary", "arm of 1000 N/m": "stiff"}


def printed_shares() -> dict[tuple[str, Hand, float], tuple[float, float]]:
    """Give median and least share of the force, as docs/study-results.md has them for law, hand and round trip."""
    found, law = {}, ""
    heads, *lines = DOCUMENT[DOCUMENT.index("\n| | 0 ms |") + 1 :].split("\n\n")[0].splitlines()
    delays_ms = [float(head) for head in re.findall(r"(\d+) ms", heads)]
    for line in lines[1:]:
        name, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        law, hand = name.split(", ") if ", " in name else (law, name)
        for delay_ms, cell in zip(delays_ms, cells, strict=True):
            middle, least = map(float, re.findall(r"\d\.\d\d", cell)[:2])
            found[law, PRINTED_HANDS[hand], delay_ms] = middle, least
    return found


def test_the_document_prints_a_share_for_every_hand_and_round_trip() -> None:
    laws = ("passivity", "wave", "model_mediated")
    assert set(printed_shares()) == set(product(laws, HANDS, ROUND_TRIPS_MS))


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.timeout(1200)
def test_over_drawn_bad_links_no_energy_is_made_at_the_device(tmp_path: Path) -> None:
    sweep = Sweep(Journal(tmp_path / "journal.jsonl"), 1)
    rows = outcomes(PASSIVE_LAWS, 50, sweep)
    assert sum(row.runs for row in rows) == 50 * len(SAMPLES) * len(PASSIVE_LAWS)
    assert broken(rows) == []
    printed = printed_shares()
    for law in PASSIVE_LAWS:
        results = sweep.run([cell for cell in drawn_cells([law], 50)])
        stable = sum(result.verdict == "stable" for result in results)
        assert re.search(rf"^\| {law} \| 300 of 300, [^|]+ \| {stable} \|", DOCUMENT, re.MULTILINE), stable
        for hand, delay_ms in product(HANDS, ROUND_TRIPS_MS):
            shares = [
                (result.tip_n or 0.0) / (2.0 if result.cell.environment == "tip_sample" else 1.0)
                for result in results
                if (result.cell.hand, result.cell.round_trip_ms) == (hand, delay_ms)
            ]
            found = median(shares), min(shares)
            assert found == pytest.approx(printed[law, hand, delay_ms], rel=0.0, abs=0.0051), (law, hand, delay_ms)


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.timeout(1200)
def test_losses_in_bursts_make_no_energy_at_the_device(tmp_path: Path) -> None:
    sweep = Sweep(Journal(tmp_path / "journal.jsonl"), 1)
    rows = outcomes(PASSIVE_LAWS, 50, sweep, 40.0)
    assert sum(row.runs for row in rows) == 50 * len(SAMPLES) * len(PASSIVE_LAWS)
    assert broken(rows) == []
    # half of the messages in rows of 40 stop hold and hand for a moment, and most holds survive it
    held = [row.stable / row.runs for row in rows if row.law == "passivity" and row.round_trip_ms <= 200.0]
    assert min(held) > 0.7


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.parametrize("stiffness", [5.0, 38.0, 80.0, 200.0])
@pytest.mark.parametrize("link", LINKS, ids=lambda link: f"{link[0]:g}ms")
def test_passivity_holds_and_makes_no_energy_at_the_device(stiffness: float, link: tuple[float, float, float]) -> None:
    hands: tuple[Hand, ...] = ("force", "ordinary")
    assert min(held("passivity", stiffness, link, hand, seed) for hand in hands for seed in SEEDS) >= -1e-6


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.parametrize(("round_trip_ms", "greatest_n"), [(200.0, 7.0), (500.0, 16.0)])
def test_smith_goes_in_by_what_the_hand_does_in_a_round_trip(round_trip_ms: float, greatest_n: float) -> None:
    found = run_cell(Cell(law="smith", environment="tip_sample", stiffness_n_per_m=40.0, round_trip_ms=round_trip_ms))
    # the tip settles, and met the sample with more than twice the force of the hand
    assert found.verdict == "stable"
    assert "struck" in found.facts
    assert found.peak_n == pytest.approx(greatest_n, rel=0.05, abs=0.0)


@pytest.mark.stack
@pytest.mark.endurance
def test_waves_over_bad_links_are_as_the_document_says() -> None:
    wave: dict[str, Any] = {"law": "wave", "environment": "spring"}
    for round_trip_ms, apart_mm in ((60.0, 0.58), (120.0, 0.87), (200.0, 1.19), (500.0, 2.4)):
        link: dict[str, Any] = {"round_trip_ms": round_trip_ms, "jitter_ms": 0.25 * round_trip_ms, "loss": 0.05}
        held = [run_cell(Cell(**wave, **link, stiffness_n_per_m=20.0, seed=seed)) for seed in range(9)]
        assert median(result.tip_n or 0.0 for result in held) == pytest.approx(1.0, rel=0.005, abs=0.0)
        assert median(1e3 * (result.apart_m or 0.0) for result in held) == pytest.approx(apart_mm, rel=0.01, abs=0.0)
    for seed in range(4):
        ripples = run_cell(Cell(**wave, round_trip_ms=60.0, jitter_ms=15.0, stiffness_n_per_m=200.0, seed=seed))
        assert 0.29 < ripples.peak_to_peak_n < 0.45
    for filter_s, ripple_n, share in ((0.02, 0.14, 0.86), (0.2, 0.05, 0.61)):
        link = {"round_trip_ms": 50.0, "jitter_ms": 12.5, "loss": 0.2, "settings": (("wave.filter_s", filter_s),)}
        for seed in range(3):
            held = [run_cell(Cell(**wave, **link, stiffness_n_per_m=80.0, hand=h, seed=seed)) for h in HANDS[:2]]
            assert held[0].peak_to_peak_n == pytest.approx(ripple_n, rel=0.3, abs=0.0)
            assert held[1].tip_n == pytest.approx(share, rel=0.01, abs=0.0)


@pytest.mark.stack
@pytest.mark.endurance
def test_local_loop_of_passivity_ends_at_the_stiffness_of_its_damper() -> None:
    cell: dict[str, Any] = {"law": "passivity", "environment": "spring", "round_trip_ms": 0.0}
    assert run_cell(Cell(**cell, stiffness_n_per_m=780.0)).verdict == "stable"
    beyond = run_cell(Cell(**cell, stiffness_n_per_m=820.0))
    assert beyond.verdict != "stable"
    # what the loop makes comes out of the stores, which were granted 2 mJ
    assert beyond.lowest_energy_j >= -2e-3

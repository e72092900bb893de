"""The table of felt stiffness, against the paper's law, further sessions, and the table that is kept."""

import json
import math
import random
from pathlib import Path
from typing import Any

import pytest
from telenano_lab.studies.loops.felt import FELT, FeltCell, felt, felt_from, felt_once, refusals
from telenano_lab.studies.option_values import COMPARED_LAWS, disturbances_of
from telenano_lab.studies.pages.felt_page import cell_words, kept_rows, markdown

from telenano.testing import invoke

# A change of these has every cell run that is tried here.
CHANGES_CELLS = (
    "telenano/analysis/", "telenano/laws/", "telenano/lockstep/", "telenano/numerics/",
    "packages/telenano-lab/telenano_lab/studies/", "packages/telenano-laws/telenano_laws/",
)  # fmt: skip


def cell(law: str, stiffness: float, instrument: str = "ideal", delay_ms: float = 0.0, **more: Any) -> FeltCell:
    return FeltCell(
        law=law,
        environment="spring",
        round_trip_ms=delay_ms,
        stiffness_n_per_m=stiffness,
        disturbances=disturbances_of(instrument),
        instrument_name=instrument,
        **more,
    )


def test_the_papers_law_is_felt_as_its_equation_says() -> None:
    found = felt(cell("virtual_impedance", 20.0, frequency_hz=0.5))
    # F_m = Z v / K_f + (1 + 1/K_f) alpha_f F_s: its mass takes M w^2 / K_f of the stiffness
    there = 150.0 * 20.0
    expected = 1.05 - 10.0 * math.pi**2 / 20.0 / there
    assert found.ratio == pytest.approx(expected, rel=0.01)
    assert found.low is not None and found.high is not None and found.low <= found.ratio <= found.high
    assert found.refused == "" and refusals([found]) == {}
    assert felt_from(json.loads(json.dumps(found.as_dict()))) == found


def test_what_is_not_stable_has_no_figure_and_is_counted() -> None:
    found = felt(cell("virtual_impedance", 38.0, delay_ms=150.0))
    assert (found.ratio, found.low, found.high) == (None, None, None)
    assert found.refused in ("diverged", "limit_cycle", "guarded") and found.refusals == found.cell.draws
    assert refusals([found, found]) == {found.refused: 2}
    assert cell_words(found.row()) == f"{found.refused.replace('_', ' ')}, 4 of 4"


def test_a_cell_has_a_key_of_its_own() -> None:
    cells = [cell("wave", 20.0, frequency_hz=hz, draws=draws) for hz in (0.5, 1.0) for draws in (2, 3)]
    assert len({one.key for one in cells}) == 4
    FELT.check(cells[0])


def drawn_cell(seed: int) -> FeltCell:
    draw = random.Random(f"felt cell {seed}")
    return cell(
        draw.choice(COMPARED_LAWS),
        math.exp(draw.uniform(math.log(10.0), math.log(80.0))),
        draw.choice(("ideal", "real")),
        draw.choice((0.0, draw.uniform(0.0, 150.0))),
        frequency_hz=draw.uniform(0.3, 2.0),
    )


def covered(seeds: range) -> tuple[int, int, int]:
    """Return how many further sessions lay in the intervals of drawn cells, of how many, and how many had none."""
    inside = of = none = 0
    for seed in seeds:
        found = felt(drawn_cell(seed))
        if found.low is None or found.high is None:
            none += 1
            continue
        for number in range(100, 103):
            further = felt_once(found.cell, number)
            of += 1
            # the figures are kept with six digits
            inside += not isinstance(further, str) and found.low * 0.99999 <= further <= found.high * 1.00001
    return inside, of, none


@pytest.mark.check("runs drawn cells of the table and further sessions of them, takes 20 s")
@pytest.mark.drawn(0.0, *CHANGES_CELLS)
def test_further_sessions_of_drawn_cells_lie_in_their_intervals() -> None:
    inside, of, none = covered(range(14))
    assert of >= 15 and inside >= 0.85 * of, (inside, of, none)


@pytest.mark.endurance("runs 200 cells of the table and further sessions of them, some 10 min")
def test_further_sessions_of_many_drawn_cells_lie_in_their_intervals() -> None:
    inside, of, none = covered(range(1000, 1200))
    assert of >= 300 and inside >= 0.92 * of, (inside, of, none)


def again_of(row: dict[str, Any]) -> dict[str, Any]:
    """Return the row that a cell of the kept table gives now."""
    found = cell(
        row["law"],
        row["stiffness_n_per_m"],
        row["instrument"],
        row["round_trip_ms"],
        frequency_hz=row["frequency_hz"],
        draws=int(row["sessions"]),
    )
    return felt(found).row()


@pytest.mark.check("runs cells of the kept table again, some seconds each")
@pytest.mark.drawn(0.25, *CHANGES_CELLS)
@pytest.mark.parametrize("number", range(8))
def test_a_cell_of_the_kept_table_comes_out_as_it_is_kept(number: int) -> None:
    row = random.Random(3).sample(kept_rows(), 8)[number]
    again = again_of(row)
    assert row["refused"] == again["refused"], row
    for name in ("felt", "low", "high"):
        assert row[name] == (None if again[name] is None else pytest.approx(again[name], rel=1e-4, abs=1e-4)), row


def test_the_page_of_the_table_has_every_cell() -> None:
    rows, text = kept_rows(), markdown()
    places = {(row["law"], row["instrument"], row["round_trip_ms"], row["frequency_hz"]) for row in rows}
    assert len([line for line in text.splitlines() if line.startswith("| `")]) == len(places) + len(
        {(row["law"], row["instrument"]) for row in rows}
    )
    assert all(row["felt"] is not None or (row["refused"] and row["refusals"] > 0) for row in rows)


def test_an_instrument_that_there_is_not_is_refused(tmp_path: Path) -> None:
    refused = invoke(["study", "transparency", "--instrument", "reel", "--law", "wave", "--out", str(tmp_path)])
    assert refused.exit_code != 0 and "instrument: unknown instrument 'reel'; did you mean real?" in refused.stderr

"""What counts as shown: nothing beyond what was run, and nothing between a cell that was held and one that was not."""

import itertools

import pytest
from telenano_lab.experiments.benchmark.shown_range import (
    Cell,
    Estimate,
    LawRange,
    Place,
    Session,
    advice,
    outside,
    read_shown,
)

from telenano.sections import LAWS


def cell(line: tuple[float, float], stiffness: float, drift: float = 0.0, *, held: int = 32) -> Cell:
    return Cell(Place(*line, stiffness, drift), 32, held, 0.89 if held == 32 else 0.4)


def exactly(value: float) -> Estimate:
    return Estimate(value, value, value)


NEAR, FAR, UNEVEN = (0.0, 0.0), (80.0, 2.0), (16.0, 70.0)
CELLS = [
    *(cell(line, k) for line in (NEAR, UNEVEN) for k in (20.0, 80.0)),
    *(cell(NEAR, k, 10.0) for k in (20.0, 80.0)),
    cell((20.0, 3.0), 20.0),
    *(cell(FAR, k, held=4) for k in (20.0, 80.0)),
]
SHOWN = LawRange(CELLS, 0.1)


@pytest.mark.parametrize(
    ("place", "holds"),
    [
        (Place(*NEAR, 20.0, 0.0), True),
        # between what was held
        (Place(10.0, 30.0, 50.0, 0.0), True),
        (Place(0.0, 0.0, 50.0, 5.0), True),
        # beyond what was run
        (Place(*NEAR, 15.0, 0.0), False),
        (Place(*NEAR, 90.0, 0.0), False),
        (Place(*NEAR, 20.0, 11.0), False),
        (Place(10.0, 71.0, 20.0, 0.0), False),
        # between a cell that was held and one that was not
        (Place(40.0, 2.0, 20.0, 0.0), False),
        # each was held with others
        (Place(18.0, 2.0, 80.0, 0.0), False),
        (Place(10.0, 2.0, 20.0, 5.0), False),
    ],
)
def test_a_place_is_shown_where_harder_ones_were_held_and_no_easier_one_was_not(place: Place, holds: bool) -> None:
    assert SHOWN.holds(place) is holds


def test_a_failed_cell_between_two_that_were_held_is_not_shown() -> None:
    hole = LawRange([cell(NEAR, 20.0), cell(FAR, 20.0), cell(FAR, 40.0), cell(FAR, 38.0, held=4)], None)
    assert hole.holds(Place(70.0, 1.0, 20.0, 0.0)) and hole.holds(Place(*FAR, 40.0, 0.0))
    assert not hole.holds(Place(70.0, 1.0, 37.0, 0.0))
    # an easier one that was failed, and is outweighed by no harder one
    assert not LawRange([*CELLS, cell((5.0, 0.0), 20.0, held=4)], None).holds(Place(10.0, 3.0, 30.0, 0.0))


def test_too_few_runs_show_nothing_and_deny_nothing() -> None:
    few = Cell(Place(10.0, 1.0, 20.0, 0.0), 8, 8, 0.68)
    assert not few.was_held and not few.was_failed
    assert not Cell(Place(10.0, 1.0, 20.0, 0.0), 0, 0, 0.0).was_failed


@pytest.mark.parametrize(
    ("session", "axis"),
    [
        (Session(), None),
        (Session(exactly(15.0), exactly(20.0), exactly(50.0)), None),
        # what a rig's own processes add is not the line's
        (Session(exactly(5.0), exactly(5.0), exactly(80.0), exactly(8.0)), None),
        (Session(Estimate(40.0, 15.0, 90.0)), None),
        (Session(exactly(78.0), exactly(1.0)), "line"),
        (Session(exactly(5.0), exactly(90.0)), "line"),
        (Session(stiffness_n_per_m=Estimate(100.0, 85.0, 150.0)), "stiffness"),
        (Session(stiffness_n_per_m=Estimate(100.0, 75.0, 150.0)), None),
        (Session(stiffness_n_per_m=Estimate(12.0, 10.0, 19.0)), "stiffness"),
        (Session(drift_pm_per_s=Estimate(20.0, 12.0, 28.0)), "drift"),
        (Session(drift_pm_per_s=Estimate(20.0, 8.0, 32.0)), None),
        (Session(exactly(26.0), exactly(2.0), exactly(80.0)), "together"),
    ],
)
def test_a_session_is_outside_where_nothing_within_its_intervals_was_shown(session: Session, axis: str | None) -> None:
    assert outside(SHOWN, session) == axis


def test_the_sentences_say_what_happened_what_it_means_and_what_to_do() -> None:
    wider = LawRange([*CELLS[:-2], *(cell(FAR, k, d) for k in (20.0, 80.0) for d in (0.0, 10.0))], 0.5)
    table = {"one": SHOWN, "other": wider, "nearer": LawRange(CELLS, 0.01)}

    def text(session: Session, choices: tuple[str, ...] = ("one", "other", "nearer")) -> str:
        axis = outside(SHOWN, session)
        assert axis is not None
        return advice(table, "one", axis, session, choices)

    far = Session(exactly(78.0), exactly(1.0))
    assert text(far) == (
        "The line is outside of the range in which one held in the benchmark: 78 ms there and back, and it held up to "
        "20 ms on some sample. "
        "The hand may feel an oscillation, or the tip may rest at another force than intended. "
        "Take other (--set controller.law=other) or a shorter line."
    )
    assert text(far, ("one", "nearer")).endswith("Take a shorter line: no law held such a session in the benchmark.")
    # a law that is not installed is named where no other fits, with how it is
    where = {"other": "the law other is in the package somebodys-laws"}
    assert advice(table, "one", "line", far, ["nearer"], where).endswith(f" or a shorter line; {where['other']}.")
    assert "5 ms there and back, at times 90 ms more, and it held up to 70 ms more" in text(
        Session(exactly(5.0), exactly(90.0))
    )
    assert "stiffer than those that one held in the benchmark: 85 to 150 N/m, where it held 20 to 80 N/m" in text(
        Session(stiffness_n_per_m=Estimate(100.0, 85.0, 150.0))
    )
    assert "20 ± 8 pm/s, and it held up to 10 pm/s" in text(Session(drift_pm_per_s=Estimate(20.0, 12.0, 28.0)))
    assert "26 ms there and back, 80 to 80 N/m together, and it held up to 16 ms" in text(
        Session(exactly(26.0), exactly(2.0), exactly(80.0))
    )


def test_the_table_that_comes_with_the_rig_is_that_of_its_laws() -> None:
    table = read_shown()
    assert set(table) >= {"virtual_impedance", "position_force", "wave", "passivity", "model_mediated"}
    assert set(table) <= set(LAWS)
    for shown in table.values():
        assert shown.held
        for place in shown.held:
            assert shown.holds(place)
        for failed in set(shown.failed) - set(shown.held):
            assert not shown.holds(failed)
        # nothing beyond the hardest and the softest that was run
        hardest = [max(places) for places in zip(*shown.held, strict=True)]
        softest = min(place.stiffness_n_per_m for place in shown.held)
        for place, axis in itertools.product(shown.held, range(4)):
            beyond = list(place)
            beyond[axis] = hardest[axis] + 0.1
            assert not shown.holds(Place(*beyond))
            assert not shown.holds(place._replace(stiffness_n_per_m=softest - 0.1))

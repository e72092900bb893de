"""Orders of conditions: what a design promises is counted, for every size, and not only for the one at hand."""

import itertools

import pytest
from telenano_lab.experiments.orders import ORDERS, balance, sequence, sequences_of_design, williams


@pytest.mark.parametrize("size", range(1, 13))
def test_a_williams_design_is_balanced_for_places_and_for_carry_over(size: int) -> None:
    square = williams(size)
    assert len(square) == (size if size % 2 == 0 or size == 1 else 2 * size)
    assert all(sorted(row) == list(range(size)) for row in square)
    found = balance(square, size)
    assert found.over_places and found.over_carry
    # taking one sequence away breaks what all of them together give
    if size > 2:
        assert not balance(square[1:], size).over_places


@pytest.mark.parametrize("kind", ORDERS)
def test_each_sequence_has_each_condition_once(kind: str) -> None:
    for number in range(20):
        assert sorted(sequence(kind, 4, number, "seed")) == [0, 1, 2, 3]  # type: ignore[arg-type]


def test_all_permutations_come_before_one_comes_again() -> None:
    count = sequences_of_design("counterbalanced", 4)
    rows = [sequence("counterbalanced", 4, number, "") for number in range(2 * count)]
    assert set(rows[:count]) == set(itertools.permutations(range(4))) == set(rows[count:])
    assert balance(rows, 4).over_carry


def test_a_shuffle_follows_its_seed_and_number_alone() -> None:
    rows = [sequence("shuffle", 6, number, "a") for number in range(8)]
    assert rows == [sequence("shuffle", 6, number, "a") for number in range(8)]
    assert rows != [sequence("shuffle", 6, number, "b") for number in range(8)]
    assert len(set(rows)) > 1


def test_an_order_as_written_is_not_called_balanced() -> None:
    found = balance([sequence("factorial", 3, number, "") for number in range(6)], 3)
    assert not found.over_places
    assert not found.over_carry
    assert found.places[0] == (6, 0, 0)
    assert found.followed[0] == (0, 6, 0)

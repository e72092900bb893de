"""The table behind `make mutation`: it names what there is, and its mutants are whole and the same every time."""

import ast

import pytest
from mutate import ROOT, SAMPLE, SEED, mutants, sampled
from mutated_modules import EQUIVALENT, MODULES


def test_each_module_has_tests_and_each_equivalent_a_reason() -> None:
    assert all((ROOT / path).is_file() for module, tests in MODULES.items() for path in (module, *tests))
    assert set(EQUIVALENT) <= set(MODULES)
    assert all(reason for entries in EQUIVALENT.values() for reason in entries.values())


@pytest.mark.check("takes 2 s, and is of the table of mutants alone")
@pytest.mark.parametrize("module", MODULES)
def test_every_mutant_of_a_module_is_python_and_has_a_name_of_its_own(module: str) -> None:
    source = (ROOT / module).read_text()
    every = mutants(source)
    # the smallest modules have fewer than are sampled
    assert len({mutant.name for mutant in every}) == len(every) >= 9
    assert all(mutant.source != source for mutant in every)
    for mutant in every[:: len(every) // 6]:
        ast.parse(mutant.source)
    # an entry that names no mutant any more is out of date
    assert set(EQUIVALENT.get(module, {})) <= {mutant.name for mutant in every}


def test_a_sample_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    module = "telenano/extend/feedback.py"
    source = (ROOT / module).read_text()
    chosen = sampled(module, source, SAMPLE, SEED)
    assert chosen == sampled(module, source, SAMPLE, SEED)
    assert len(chosen) == SAMPLE
    assert chosen != sampled(module, source, SAMPLE, SEED + 1)
    assert len(sampled(module, source, 10_000, SEED)) == len(mutants(source))


def test_comparisons_bounds_constants_and_statements_are_changed_and_texts_are_not() -> None:
    source = "def f(x: int = 3) -> float:\n    if x < 2 and not x:\n        g('a' + 'b')\n    return max(x, 1.5)\n"
    found = {mutant.name.partition("[")[2] for mutant in mutants(source)}
    assert found == {
        "3 => 4]", "x < 2 => x <= 2]", "x < 2 => x >= 2]", "x < 2 and (not x) => x < 2 or not x]", "2 => 3]",
        "not x => x]", "g('a' + 'b') => pass]", "max(x, 1.5) => min(x, 1.5)]", "max(x, 1.5) => x]",
        "max(x, 1.5) => 1.5]", "1.5 => 3.0]", "x < 2 and (not x) => False]",
    }  # fmt: skip

"""The words of CONTRIBUTING's table are counted where people read them, and their number only falls."""

from collections import Counter

import plain_words
import pytest
from printed_texts import of_python, of_script, printed_texts


@pytest.fixture(scope="module")
def known() -> list[plain_words.Word]:
    return plain_words.words()


def test_the_table_is_short_and_marks_the_worst(known: list[plain_words.Word]) -> None:
    assert len(known) <= 60
    assert sum(word.is_worst for word in known) == 20


def test_no_more_of_them_are_written(known: list[plain_words.Word]) -> None:
    found = Counter(one.kind for one in plain_words.findings(known))
    most = plain_words.ceilings()
    assert most.keys() == {"identifier", "message", "prose", "value"}
    risen = {kind: found[kind] for kind in most if found[kind] > most[kind]}
    assert not risen, f"`python tests/contract/plain_words.py {' '.join(risen)}` lists them"


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("told_of_queue = 1", ["identifier"]),
        ("class ToldTwice: ...", ["identifier"]),
        ("def opened_anew(): ...", ["identifier"]),
        ("def f(nobody): ...", ["identifier"]),
        ("f('nobody answers')", ["message"]),
        ('"""Whoever calls."""', ["prose"]),
        ("# so many\nx = 1", ["prose"]),
        ("retold = 'foretold'", []),
    ],
)
def test_a_word_is_found_where_it_stands(known: list[plain_words.Word], text: str, kinds: list[str]) -> None:
    found = [
        kind
        for kind, _, part in plain_words.of_python(text)
        for word in known
        for _ in word.pattern.finditer(part)
        if word.is_worst
    ]
    assert found == kinds


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("found = 1", ["found"]),
        ("self._known = {}", ["known"]),
        ("def f(given): ...", ["given"]),
        ("rows = [told for told in heard]", ["told"]),
        ("def found(): ...", []),
        ("found_rows = other.found", []),
    ],
)
def test_a_value_is_counted_whose_name_does_not_say_what_it_is(text: str, names: list[str]) -> None:
    assert [one.word.name for one in plain_words.vague_values(text, "module.py")] == names


def test_the_list_of_printed_texts_has_plain_and_formatted_ones_and_no_docstring() -> None:
    source = (
        '"""A module that prints what it knows."""\n'
        "def refuse(port):\n"
        '    """Refuse a port that another rig has."""\n'
        '    raise ConfigError(f"port {port} is in use: set VIEW_PORT", "a name")\n'
        'ADVICE = "start the rig again, and " "arm it"\n'
    )
    assert list(of_python(source)) == [
        (4, "port {port} is in use: set VIEW_PORT"),
        (5, "start the rig again, and arm it"),
    ]
    assert [text for _, text in of_script('say("the arm let go of it"); say("no"); x(`of ${n} the last one`)')] == [
        "the arm let go of it",
        "of {n} the last one",
    ]


@pytest.mark.check("parses every module")
def test_the_list_of_printed_texts_has_those_of_library_packages_and_page() -> None:
    places = [text.place for text in printed_texts()]
    assert len(places) > 1000
    assert {place.partition("/")[0] for place in places} == {"telenano", "services", "packages", "deploy"}
    assert any(".ts:" in place for place in places)

"""Text of strangers is one line, can be encoded, and ends no quotation of a sentence."""

import random

import pytest

from telenano.wire.errors import ConfigError, described
from telenano.wire.printable import one_line, printable, shown

SEED = 95
LETTERS = [*map(chr, range(0xA0)), *"`'\"\\é漢µ", "\u202e", "\u2028", "\u2066", "\ud800", "\udfff", "\U0001f600"]


def drawn(count: int) -> list[str]:
    random_ = random.Random(SEED)
    return ["".join(random_.choices(LETTERS, k=random_.randint(0, 40))) for _ in range(count)]


@pytest.mark.parametrize("write", [one_line, shown])
def test_any_text_is_one_line_that_can_be_written(write: object) -> None:
    for text in drawn(2000):
        made = write(text)  # type: ignore[operator]
        made.encode()
        assert len(made.splitlines()) <= 1 and made.isprintable()
        assert write(made) == made or len(made) > 200  # type: ignore[operator]


def test_a_sentence_has_no_quotation_mark_of_a_stranger_and_a_bounded_part_of_its_text() -> None:
    assert not any("`" in shown(text) for text in drawn(2000))
    assert shown("x" * 1000) == "x" * 200 + "... (1000 characters)"
    printable("a\n\ud800\tb").encode()


def test_an_error_of_several_lines_has_each_as_an_argument() -> None:
    error = ConfigError("a: is wrong", "b: is wrong")
    assert (str(error), error.lines) == ("a: is wrong\nb: is wrong", ("a: is wrong", "b: is wrong"))
    assert ConfigError().lines == ()


def test_what_is_said_of_an_error_is_one_line_whatever_it_is() -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise self

    group = BaseExceptionGroup("g\n", [ValueError("a`\n"), BaseExceptionGroup("h", [MuteError()])])
    assert described(group).count("\n") == 0
    assert "ValueError: a\\x60\\n" in described(group) and "whose text cannot be made" in described(group)

"""Text tables as many programs write them: drawn files have one meaning each, which the reader must find or refuse."""

import math
from itertools import product

import numpy as np
import pytest

from telenano.files.text_tables import TextTable
from telenano.files.units import unit_of
from telenano.wire.errors import ConfigError

# name, unit as written, and its factor to SI
UNITS = [
    ("frequency", "kHz", 1e3), ("z", "µm", 1e-6), ("z", "\u03bcm", 1e-6), ("height", "Å", 1e-10), ("U", "mV", 1e-3),
    ("PSD", "V^2/Hz", 1.0), ("noise", "pm/√Hz", 1e-12), ("ASD", "uV/sqrt(Hz)", 1e-6), ("F", "nN", 1e-9),
    ("t", "ms", 1e-3),
    ("share", "%", 0.01), ("slope", "nm/V", 1e-9), ("k", "N/m", 1.0), ("noise", "fm per root Hz", 1e-15),
]  # fmt: skip
FORMS = ("{} [{}]", "{} ({})", "{} / {}", "{}, {}", "{} in {}")
BEFORE = ("", "# made by a program\n", "Points 512\nMade on 2026-11-26\n\n", "% k = 0,35 N/m\n// by hand\n")
# separator, decimal mark, encoding, end of a line
WRITTEN = (
    ("\t", ".", "utf-8", "\n"), ("\t", ",", "utf-8", "\r\n"), (";", ",", "utf-8-sig", "\n"), (";", ".", "utf-8", "\n"),
    (",", ".", "utf-8", "\r\n"), ("  ", ".", "utf-8", "\n"), ("\t", ",", "utf-16", "\n"), (";", ",", "cp1252", "\r\n"),
)  # fmt: skip


@pytest.mark.parametrize(("written", "before"), list(product(WRITTEN, BEFORE)))
def test_a_table_has_the_values_and_units_that_were_written(written: tuple[str, str, str, str], before: str) -> None:
    separator, mark, encoding, end = written
    draw = np.random.default_rng([WRITTEN.index(written), BEFORE.index(before)])
    for _ in range(6):
        chosen = [UNITS[n] for n in draw.integers(len(UNITS), size=draw.integers(1, 5))]
        form = FORMS[draw.integers(2 if separator == "  " else len(FORMS) - (separator == ","))]
        form = "{} [{}]" if separator in ("  ", ",") and "," in form else form
        if separator == "  ":
            chosen = [one for one in chosen if " " not in one[1]] or [UNITS[0]]
        values = 10.0 ** draw.uniform(-12, 6, (30, len(chosen))) * draw.choice((-1.0, 1.0), (30, len(chosen)))
        lost = draw.random(values.shape) < 0.05
        words = [
            ["NaN" if gone else repr(float(v)) for v, gone in zip(*row, strict=True)]
            for row in zip(values, lost, strict=True)
        ]
        words[0] = [repr(float(v)) for v in values[0]]
        lost[0] = False
        text = "".join(separator.join(row).replace(".", mark) + "\n" for row in words)
        head = separator.join(form.format(name, unit) for name, unit, _ in chosen)
        content = f"{before}{head}\n{text}"
        try:
            raw = content.replace("\n", end).encode(encoding)
        except UnicodeEncodeError:
            # an older Windows has no root and no Greek letter
            continue
        if len(chosen) == 1 and mark == ",":
            # 1,5 alone may be two columns
            continue
        table = TextTable.parse(raw, "t")
        assert len(table.columns) == len(chosen)
        for column, (name, unit, factor), truth, gone in zip(table.columns, chosen, values.T, lost.T, strict=True):
            assert column.name == name
            found = table.in_si(column, (unit,))
            assert found is not None
            np.testing.assert_allclose(found, np.where(gone, math.nan, truth * factor), rtol=1e-12)
        assert any("decimal" in remark for remark in table.remarks) == (mark == "," and any("," in w for w in text))


ROWS = "".join(f"{n}.5\t{n}.25\n" for n in range(100))
NUMBERS = ("7\n", "1.5\t2.5\n3.5\t4.5\n", "1\t2\t3\t4\n5\t6\t7\t8\n", "1;2;3\n", "0.5 0.25\n")
MARKS = (
    "[DATA]\n", "[Data]\n", "\\*File list end\n", "*File list end\n", "***End_of_Header***\n", "# Start of Data:\n",
    "Daten:\n", "\n", "some words\n",
)  # fmt: skip


@pytest.mark.parametrize(("numbers", "mark"), list(product(NUMBERS, MARKS)))
def test_numbers_in_a_head_are_no_table(numbers: str, mark: str) -> None:
    table = TextTable.parse(f"Settings\n{numbers}{mark}z [nm]\tU [V]\n{ROWS}".encode(), "t")
    assert [column.name for column in table.columns] == ["z", "U"]
    assert (len(table.lines), table.columns[0].values[0]) == (100, 0.5)
    assert "are of its head" in " ".join(table.remarks)


def test_numbers_before_a_blank_line_leave_the_titles_above_them() -> None:
    table = TextTable.parse(f"z [nm]\tU [V]\n9.5\t8.5\n\n{ROWS}".encode(), "t")
    assert [column.unit for column in table.columns] == ["nm", "V"]
    assert len(table.lines) == 100
    # comments among the rows are kept, with the count of rows before them
    table = TextTable.parse(f"a\tb\n{ROWS}# segment: retract\n{ROWS}".encode(), "t")
    assert (len(table.lines), table.notes) == (200, ((100, "# segment: retract"),))


def test_a_damaged_row_near_the_begin_is_no_end_of_a_head() -> None:
    table = TextTable.parse(f"a [s]\tb [s]\n1.5\t2.5\n2.5\tx3.5\n{ROWS}".encode(), "t")
    assert len(table.lines) == 102
    with pytest.raises(ConfigError, match=r"line 3: 'x3\.5' is not a number"):
        table.in_si(table.columns[1], ("s",))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "t: is empty"),
        ("  \n\n", "t: is empty"),
        ("a\0b", "is not text: it has zero bytes"),
        ("by hand\nno number\n", "has no line of numbers in its first 2 lines"),
        ("60000,250,1,2E-27\n60001,500,1,3E-27\n", "line 1: has 4 columns separated by commas and no decimal point"),
        ("z [nm],U [V]\n0,0,5\n1,5,0,6\n2,5,0,7\n", "line 3: has 4 columns separated by commas and no decimal point"),
        ("1,304,-0,012,0,7\n-1,25,0,5,0,081\n", "line 1: has 6 columns separated by commas and no decimal point"),
        ("f;d\n1,5;2\n1.5;2\n", "line 2 has a decimal comma and line 3 a point"),
        ("a\tb\n1\t2\nretract\n1\t2\n", "line 3: is not a line of numbers, after 1 that are"),
        ("1 2\n3 4 5\n6 7\n", "line 2: has 3 columns, where the others have 2"),
    ],
)
def test_what_is_no_table_or_could_be_two_is_refused_with_its_line(text: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        TextTable.parse(text.encode(), "t")


@pytest.mark.parametrize(
    ("head", "wanted", "reason"),
    [
        ("z [furlong]", "m", r"t, line 1: the unit 'furlong' of 'z \[furlong\]': is not known; give one such as m"),
        ("z [V]", "m", "line 1: the unit 'V' of .*: is of another kind than m"),
        ("f (mhz)", "Hz", "line 1: the unit 'mhz'"),
    ],
)
def test_a_unit_that_is_named_and_not_known_is_refused_with_its_line(head: str, wanted: str, reason: str) -> None:
    table = TextTable.parse(f"{head}\n1.5\n2.5\n".encode(), "t")
    with pytest.raises(ConfigError, match=reason):
        table.in_si(table.columns[0], (wanted,), "", "")
    assert table.in_si(table.columns[0], ("m",), "nm") is not None


def test_a_word_among_numbers_is_refused_where_its_column_is_used() -> None:
    table = TextTable.parse(b"t_s,x_m,host\n1,2,a\n2,loud,b\n", "t")
    assert table.in_si(table.columns[0], ("s",)) is not None
    with pytest.raises(ConfigError, match="t, line 3: 'loud' is not a number"):
        table.in_si(table.columns[1], ("m",))


@pytest.mark.parametrize(
    "text", ["", "foo", "a.u.", "dB", "mhz", "V/", "/Hz", "V^99", "m" * 100, "Hz Hz foo", "counts"]
)
def test_what_is_no_unit_is_none(text: str) -> None:
    assert unit_of(text) is None


@pytest.mark.parametrize(
    ("text", "heights"),
    [
        (
            "Höhe [nm];Kraft [nN]\n1.001,74;0,0023\n1.000,5;0,01\n999,25;0,2\n-1.234.567,5;1,0\n",
            [1001.74, 1000.5, 999.25],
        ),
        (
            "height [nm]\tforce [nN]\n1,001.74\t0.0023\n1,000.5\t0.01\n999.25\t0.2\n12.0\t1.0\n",
            [1001.74, 1000.5, 999.25],
        ),
    ],
)
def test_marks_between_thousands_are_none_of_a_decimal(text: str, heights: list[float]) -> None:
    table = TextTable.parse(text.encode(), "t.txt")
    assert table.columns[0].values[:3].tolist() == heights
    assert table.columns[0].unit == "nm"
    assert len(table.head) == 1


def test_an_integer_with_a_mark_of_thousands_beside_decimal_commas_is_refused_with_both_lines() -> None:
    with pytest.raises(ConfigError, match="nothing between thousands"):
        TextTable.parse(b"a;b\n1,5;2,5\n1.001;2,5\n2,5;3,5\n", "t.txt")

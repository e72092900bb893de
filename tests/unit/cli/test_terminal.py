"""What others wrote reaches a terminal as text: it colours, erases and titles nothing."""

import io
import sys
from pathlib import Path

import damaged_files as files
import pytest
from rich.console import Console

from telenano.cli import output, terminal
from telenano.cli.tables import rows_table, summary_tables
from telenano.testing import install_package, run_apart
from telenano.wire.printable import printable

ROOT = Path(__file__).parents[3]
# sets the title of the window, clears the screen, overwrites the line, as 8-bit control, turns the direction
HOSTILE = "\x1b]0;mine\x07\x1b[2J\rover\x9b31m\u202eright"
SHOWN = r"\x1b]0;mine\x07\x1b[2J\rover\x9b31m\u202eright"


def test_numbers_in_a_list_have_as_many_digits_as_others() -> None:
    drawn = Console(file=io.StringIO(), width=100)
    drawn.print(rows_table([{"target_m": (-1.0000000000000002e-06, -0.0, 3, "z"), "error_m": 1.0376432e-08}]))
    assert "-1e-06, 0, 3, z" in drawn.file.getvalue()  # type: ignore[attr-defined]


def test_only_what_a_terminal_obeys_is_written_out() -> None:
    assert printable(HOSTILE) == SHOWN
    assert printable("tabs\tlines\n12 µm, 3 Å: größer 漢 \u00a0") == "tabs\tlines\n12 µm, 3 Å: größer 漢 \u00a0"
    assert printable(printable(HOSTILE)) == SHOWN


def test_a_stream_is_made_printable_and_rich_draws_through_it(monkeypatch: pytest.MonkeyPatch) -> None:
    behind = io.StringIO()
    monkeypatch.setattr(sys, "stdout", behind)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    terminal.install()
    terminal.install()
    sys.stdout.writelines([HOSTILE, "\n"])
    assert behind.getvalue() == SHOWN + "\n"
    # what draws a table reaches the terminal as it is
    Console().file.write("\x1b[0m")
    assert behind.getvalue() == SHOWN + "\n\x1b[0m"


def test_a_cell_of_a_table_is_text_and_the_table_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = output.PrintableConsole(file=io.StringIO(), force_terminal=True, width=200, color_system="truecolor")
    drawn.print(rows_table([{"name": HOSTILE, "kept": True}], title=HOSTILE))
    shown = drawn.file.getvalue()
    assert SHOWN in shown
    assert "\x1b]0;" not in shown and "\x1b[2J" not in shown and "\x9b" not in shown
    # the colours of the project's own
    assert "\x1b[32m" in shown


def package(folder: Path, source: str) -> Path:
    """Make an installed package of one module with a law that is called `hostile`."""
    install_package(folder, "hostile", {"__init__.py": source}, {"laws": {"hostile": "hostile:LAW"}})
    return folder


@pytest.mark.check("takes 0.9 s")
def test_texts_of_a_package_are_shown_as_text(tmp_path: Path) -> None:
    folder = package(tmp_path / "site", f"raise ValueError({HOSTILE!r})\n")
    done = run_apart("law", "list", PYTHONPATH=str(folder), XDG_CACHE_HOME=str(tmp_path))
    assert done.returncode == 0
    assert done.stderr.startswith(
        "telenano: hostile of the package hostile 1.2 cannot be used: ValueError: \\x1b]0;mine"
    )
    assert not set(done.stderr) & set("\x1b\x07\r\x9b\u202e")


def test_titles_of_a_file_are_shown_as_text(tmp_path: Path) -> None:
    path = tmp_path / "session.mcap"
    channel = files.mcap_channel(1, "\x1b[2Ja\x07")
    path.write_bytes(files.mcap(channel, files.mcap_record(5, bytes([1, 0]) + bytes(20)), summary=channel))
    done = run_apart("bag", "info", str(path))
    assert done.returncode == 0
    assert r"\x1b[2Ja\x07" in done.stdout
    assert not set(done.stdout) & set("\x1b\x07\r\x9b\u202e")


@pytest.mark.check("takes 3.0 s")
def test_a_package_that_exits_does_not_end_a_command_in_silence(tmp_path: Path) -> None:
    """`up` printed nothing, ran nothing and returned 0."""
    site = package(tmp_path / "site", "raise SystemExit(0)\n")
    environment = {"PYTHONPATH": str(site), "XDG_CACHE_HOME": str(tmp_path)}
    done = run_apart("up", "--scenario", "fig12", "--set", "controller.law=hostile", **environment)
    assert done.returncode == 2
    assert "controller.law: hostile of the package hostile 1.2 cannot be used: its import ends the whole" in done.stderr
    done = run_apart("scenario", "check", "fig12", **environment)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_long_row_of_a_summary_is_drawn_upright_and_a_fact_by_its_text() -> None:
    fact = {"kind": "arrived_late", "value": 0.38861, "text": "arrived late, 0.39 s after the hand stood still"}
    hold = {f"key_{number}": 3.25944e-10 for number in range(12)} | {"facts": [fact]}
    drawn = io.StringIO()
    Console(file=drawn, width=100).print(
        summary_tables({"holds": [hold, {**hold, "facts": []}], "drops": [{"count": 3}]}, "title")
    )
    lines = drawn.getvalue().splitlines()
    assert sum(line.count("3.25944e-10") for line in lines) == 24
    assert sum(fact["text"] in line for line in lines) == 1
    assert "kind" not in drawn.getvalue()
    assert any(line.split() == ["┃", "count", "┃"] for line in lines)


@pytest.mark.parametrize("environment", [{}, {"NO_COLOR": "1", "FORCE_COLOR": "1"}])
def test_a_table_in_a_pipe_is_a_line_a_row_with_columns_that_programs_find(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], environment: dict[str, str]
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    rows = [{"law": "wave", "about": "Wave variables " * 20, "share": 0.25}, {"law": "a", "about": "", "share": 1.0}]
    output.print_rows(rows, title="laws")
    title, headings, *cells = capsys.readouterr().out.splitlines()
    assert title == "laws"
    places = [headings.index(name) for name in ("law", "about")]
    assert [[line[place:].split("  ")[0].strip() for place in places] for line in cells] == [
        ["wave", ("Wave variables " * 20).strip()],
        ["a", ""],
    ]
    assert [line.split()[-1] for line in cells] == ["0.25", "1"]
    assert not any("\x1b" in line or line != line.rstrip() or not line.isascii() for line in cells)

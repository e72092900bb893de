"""How far a command is: a line now and then where its output is a pipe, and nothing beside JSON."""

import pytest

from telenano.cli import progress_bar as module
from telenano.cli.progress_bar import LINE_EVERY_S, progress


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_in_a_pipe_a_line_comes_every_ten_seconds(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(module, "_clock", clock)
    with progress("cells", 40, counted=True) as show:
        for done in range(41):
            show(done)
            clock.now_s += 0.26 * LINE_EVERY_S
        clock.now_s += LINE_EVERY_S
        show(40)
    lines = capsys.readouterr().err.splitlines()
    # Four of forty took 10.4 s.
    assert lines[0] == "telenano: cells: 4 of 40, some 2 min left"
    assert lines[-2] == "telenano: cells: 36 of 40, some 10 s left"
    assert len(lines) == 10
    # what has not moved on is not said again
    assert lines[-1] == "telenano: cells: 40 of 40"


def test_the_whole_may_be_known_late_and_the_text_may_change(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(module, "_clock", clock)
    with progress("reproduce") as show:
        for total, text in ((None, None), (4.0, "fig5")):
            clock.now_s += LINE_EVERY_S
            show(1.0, total, text)
    assert capsys.readouterr().err.splitlines() == ["telenano: reproduce: 1 done", "telenano: fig5: 25 %"]


def test_a_short_command_and_one_that_prints_json_say_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    for shown in (True, False):
        with progress("lines", 2, shown=shown) as show:
            show(1)
    assert capsys.readouterr().err == ""

"""The live table of `telenano up`: what was printed before it and matters all the time stands below it."""

import io
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console, Group
from rich.text import Text

from telenano.cli import live_view


def test_why_there_is_no_page_stays_below_the_table_that_is_redrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_view, "rig_picture", lambda rig: Group(Text("the table")))
    out = io.StringIO()
    view = live_view.LiveView(Console(file=out, force_terminal=True, width=80))
    rig: Any = SimpleNamespace()
    with view:
        view.observe(rig)
        assert "no view" not in out.getvalue()
        view.footnote = "no view: its page has not been built: `make page` in the repository builds it"
        for _ in range(100):
            out.seek(0)
            out.truncate()
            view.observe(rig)
            if "the table" in out.getvalue():
                break
        assert out.getvalue().index("the table") < out.getvalue().index("no view: its page has not been built")

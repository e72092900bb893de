"""States of the page in three widths, light and dark, as pictures to look at, without a rig.

    python tests/stack/page_states.py out/states
    python tests/stack/page_states.py out/states armed pressing      # of these states alone

A change of the page is looked at with these before and after. `states` has what the rig says in each.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

# A program that is run by itself finds what the tests share as they do.
sys.path.append(str(Path(__file__).resolve().parents[1] / "doubles"))

from browser_page import Page, View, browser, keep, open_page
from page_without_rig import OBSERVER_TOKEN, TOKEN, SaidRig, served

WIDTHS = {1366: 768, 768: 1024, 390: 844}
_FAR = {"separation_m": 9.7e-9, "tip_force_n": (0.0, 0.0, -0.1e-9), "in_contact": False, "meniscus": False}
_WAY = {"offset_m": 1.0e-7, "return_place_m": 1.05e-8, "return_speed_m_per_s": 1.5e-8, "return_s": 6.6}


class State(NamedTuple):
    """What the rig says, as fields of `SaidRig`, and what is done on the page before the picture.

    held_by_other: another window has taken control before; is_cut: the server of the page ends before the picture.
    """

    said: dict[str, Any]
    act: Callable[[Page], object] = lambda page: None
    token: str = TOKEN
    held_by_other: bool = False
    is_cut: bool = False


def _take(page: Page) -> None:
    page.click("#lease [data-action=take]")
    page.until("telenano.store.lease.holder === telenano.store.me", "control")


def _hold(page: Page) -> None:
    _take(page)
    page.value("telenano.cockpit.hand.holdHere(); 0")


def _press(page: Page) -> None:
    _hold(page)
    page.value("telenano.cockpit.hand.lower(0.0115); 0")


def _go_back(page: Page) -> None:
    _take(page)
    page.until("telenano.cockpit.commands.wayBack", "a way back")
    page.value("void telenano.cockpit.commands.goBack(); 0")


STATES: dict[str, State] = {
    "free": State({"tip": _FAR}),
    "stopped": State({"is_stopped": True, "tip": _FAR}, lambda page: page.page.wait_for_timeout(1700.0)),
    "armed": State({"tip": {**_FAR, "separation_m": 1.1e-7}, "way": _WAY}, _take),
    "going": State({"tip": {**_FAR, "separation_m": 1.1e-7}, "way": _WAY, "way_s": 30.0}, _go_back),
    "approach": State({"tip": _FAR}, _take),
    "meniscus": State(
        {"tip": {**_FAR, "separation_m": 0.6e-9, "tip_force_n": (0.0, 0.0, -12.5e-9), "meniscus": True}}, _hold
    ),
    "pressing": State(
        {
            "tip": {
                "separation_m": -1.34e-9,
                "tip_force_n": (0.0, 0.0, 22.97e-9),
                "in_contact": True,
                "deflection_m": 5.7e-10,
            },
            "hand": {"position_m": (0.0, 0.0, -7.94e-3), "reference_m": (0.0, 0.0, -7.94e-3)},
        },
        _press,
    ),
    "imaging": State(
        {
            "tip": _FAR,
            "program": {"program": "scan", "state": "running", "text": "line 12 of 48", "done_percent": 25.0},
        },
        _take,
    ),
    "observer": State({"tip": _FAR}, token=OBSERVER_TOKEN),
    "waiting": State({"is_silent": True}),
    "held": State({"tip": _FAR}, held_by_other=True),
    "guarded": State(
        {
            "tip": {**_FAR, "mode": "retracted", "separation_m": 1.1e-7},
            "event": {"kind": "mode", "level": "warning", "text": "the AFM is in mode retracted: force_limit"},
        },
        _take,
    ),
    "disconnected": State({"tip": _FAR}, is_cut=True),
}


def look(found: Any, served_page: Callable[[], Any], name: str, state: State, folder: Path) -> None:
    """Keep a picture of a state at each width, light and dark."""
    for width, height in WIDTHS.items():
        with served_page() as (address, end):
            other = open_page(found, address) if state.held_by_other else None
            if other:
                _take(other)
            for scheme in ("light",) if state.is_cut else ("light", "dark"):
                size = {"width": width, "height": height}
                page = open_page(found, address, viewport=size, color_scheme=scheme, has_touch=width < 1000)
                state.act(page)
                if state.is_cut:
                    end()
                page.page.wait_for_timeout(1500.0)
                keep(page.page.screenshot(), folder / f"{name}-{width}-{scheme}.png")
                if page.faults and not state.is_cut:
                    sys.stderr.write(f"{name}, {width} px, {scheme}: {page.faults}\n")
                page.page.context.close()
            if other:
                other.page.context.close()


@contextmanager
def said(state: State) -> Iterator[tuple[str, Callable[[], None]]]:
    """Serve the page of a rig that says what a state has."""
    rig = SaidRig()
    for key, value in state.said.items():
        setattr(rig, key, value)
    with ExitStack() as stack:
        _, address = stack.enter_context(served(rig))
        yield f"{address}#{state.token}", stack.close


@contextmanager
def recorded() -> Iterator[tuple[str, Callable[[], None]]]:
    """Serve the recording that comes with the project."""
    view = View(dict(os.environ), "--demo")
    try:
        yield view.operator, lambda: None
    finally:
        view.close()


def main(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with browser() as found:
        for name, state in STATES.items():
            if not names or name in names:
                look(found, partial(said, state), name, state, folder)
        if not names or "recording" in names:
            look(found, recorded, "recording", State({}, lambda page: page.page.wait_for_timeout(4000.0)), folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])

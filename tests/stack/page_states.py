"""Ten states of the page in three widths, light and dark, as pictures to look at, without a rig.

    python tests/stack/page_states.py out/states
    python tests/stack/page_states.py out/states armed pressing      # of these states alone

A change of the page is looked at with these before and after. `states` has what the rig says in each.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from browser_page import Page, View, browser, keep, open_page
from page_without_rig import OBSERVER_TOKEN, TOKEN, SaidRig, served

WIDTHS = {1366: 768, 768: 1024, 390: 844}
_FAR = {"separation_m": 9.7e-9, "tip_force_n": (0.0, 0.0, -0.1e-9), "in_contact": False, "meniscus": False}
_WAY = {"offset_m": 1.0e-7, "return_place_m": 1.05e-8, "return_speed_m_per_s": 1.5e-8, "return_s": 6.6}


class State(NamedTuple):
    """What the rig says, as fields of `SaidRig`, and what is done on the page before the picture."""

    said: dict[str, Any]
    act: Callable[[Page], object] = lambda page: None
    token: str = TOKEN


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
}


def look(
    found: Any,
    address: str,
    name: str,
    act: Callable[[Page], object],
    folder: Path,
    end: Callable[[], None] = lambda: None,
) -> None:
    """Keep a picture of a state at each width, light and dark."""
    for width, height in WIDTHS.items():
        for scheme in ("light", "dark"):
            size = {"width": width, "height": height}
            page = open_page(found, address, viewport=size, color_scheme=scheme, has_touch=width < 1000)
            act(page)
            page.page.wait_for_timeout(1500.0)
            end()
            keep(page.page.screenshot(), folder / f"{name}-{width}-{scheme}.png")
            if page.faults:
                sys.stderr.write(f"{name}, {width} px, {scheme}: {page.faults}\n")
            page.page.context.close()


@contextmanager
def recorded() -> Iterator[str]:
    """Serve the recording that comes with the project."""
    import os

    view = View(dict(os.environ), "--demo")
    try:
        yield view.operator
    finally:
        view.close()


def main(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with browser() as found:
        for name, state in STATES.items():
            if names and name not in names:
                continue
            rig = SaidRig()
            for key, value in state.said.items():
                setattr(rig, key, value)
            with served(rig) as (_, address):
                look(found, f"{address}#{state.token}", name, state.act, folder)
        if not names or "recording" in names:
            with recorded() as address:
                look(found, address, "recording", lambda page: page.page.wait_for_timeout(4000.0), folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])

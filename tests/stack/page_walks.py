"""What the walks of a person through the page share: named steps, a keyboard without a pointer, and a look around.

With TELENANO_PICTURES a look keeps a picture of the page at each size that docs/view.md shows.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from browser_page import AXE, Page, keep

# more than the page has places for the focus
_MOST_STEPS = 250
# a click that a pointer makes has a count, and that of a key has none
_WATCH = """
globalThis.pointed = 0;
for (const name of ["pointerdown", "wheel", "touchstart"]) addEventListener(name, () => { pointed += 1; }, true);
addEventListener("click", (event) => { if (event.isTrusted && event.detail > 0) pointed += 1; }, true);
"""
_FOCUS_IS_SEEN = """(() => {
  const found = document.activeElement, style = getComputedStyle(found);
  const box = found.getBoundingClientRect();
  const inside = box.bottom > 0 && box.top < innerHeight && box.width > 0;
  return inside && (style.outlineStyle !== "none" || style.boxShadow !== "none");
})()"""


@contextmanager
def step(name: str) -> Iterator[None]:
    """Name a step of a walk: what fails in it says so."""
    try:
        yield
    except BaseException as error:
        error.add_note(f"at the step of the walk: {name}")
        raise


class Keyboard:
    """A person who has a keyboard and no pointer."""

    def __init__(self, page: Page) -> None:
        self.page = page
        page.value(f"{_WATCH}; 0")

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.page.keyboard.press(key)

    def reach(self, selector: str) -> None:
        """Go on with Tab until an element has the focus, which is then seen."""
        for _ in range(_MOST_STEPS):
            if self.page.value(f"document.activeElement?.matches({selector!r})"):
                assert self.page.value(_FOCUS_IS_SEEN), f"it is not seen that {selector} has the focus"
                return
            self.press("Tab")
        raise AssertionError(f"{selector} cannot be reached with the keyboard")

    def type(self, selector: str, text: str) -> None:
        """Put a text into a field."""
        self.reach(selector)
        self.press("Control+a")
        self.page.page.keyboard.type(text)

    def choose(self, selector: str, value: str) -> None:
        """Choose an option by the letters that it begins with, as a list is operated; the arrow keys do the rest."""
        self.reach(selector)
        options = self.page.value(f"[...document.querySelector({selector!r}).options].map((found) => found.value)")
        chosen = f"document.querySelector({selector!r}).value"
        while (now := self.page.value(chosen)) != value:
            self.press("ArrowDown" if options.index(now) < options.index(value) else "ArrowUp")
            assert self.page.value(chosen) != now, f"the keys do not move {selector}"

    def answered(self, selector: str, *, key: str = "Enter") -> str:
        """Press a button that has the focus, and return the answer."""
        self.reach(selector)
        return self.page.answered(lambda: self.press(key))

    def check(self) -> None:
        """Check that nothing was pointed at."""
        assert self.page.value("pointed") == 0
        assert self.page.faults == []


class Size(NamedTuple):
    """A window: its name, width and height, and whether the page may be longer than it."""

    name: str
    width: int
    height: int
    scrolls: bool


_SIZES = (
    Size("laptop", 1366, 768, False),
    Size("desktop", 1920, 1080, False),
    Size("tablet", 1024, 768, True),
    Size("phone", 390, 844, True),
)
# The documents show one window of a state each, and of these the larger one, or both.
_DESKTOP = ("live", "recording")
_NO_LAPTOP = ("recording",)
# boxes of the parts of a page that must be seen without scrolling, wherever they are
_BOXES = """(names) => names.map((name) => {
  const box = document.querySelector(name).getBoundingClientRect();
  return [name, box.left, box.top, box.right, box.bottom];
})"""
_OVERFLOW = "[document.documentElement.scrollWidth - innerWidth, document.documentElement.scrollHeight - innerHeight]"
_FIRST = ("#status", "#estop", "#hand-force", "#felt-force", "#gap")
_RULES = "axe.run({ runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa'] })"


def check_rules(page: Page, where: str) -> None:
    """Check what axe-core can tell of WCAG 2.2, level AA: names, roles, contrast, focus."""
    page.value(f"{AXE.read_text()}; 0")
    found = page.value(_RULES)
    assert found["passes"]
    faults = {fault["id"]: [node["html"][:200] for node in fault["nodes"]] for fault in found["violations"]}
    assert faults == {}, where


def theme(page: Page, name: str) -> None:
    if page.value("document.documentElement.dataset.theme") != name:
        page.click("#theme")


def look(page: Page, state: str) -> None:
    """Look at a state at every size: nothing sticks out, the stop and the forces are seen, axe finds nothing."""
    for size in _SIZES:
        with step(f"a look at the state {state} on a {size.name}"):
            page.page.set_viewport_size({"width": size.width, "height": size.height})
            page.page.evaluate("scrollTo(0, 0)")
            page.page.wait_for_timeout(1200.0)
            beside, below = page.value(_OVERFLOW)
            assert beside <= 0, f"{beside} px stick out at the side"
            assert size.scrolls or below <= 0, f"{below} px are below the fold"
            for name, left, top, right, bottom in page.page.evaluate(_BOXES, list(_FIRST)):
                seen = left >= 0 and top >= 0 and right <= size.width and bottom <= size.height
                assert seen, f"{name} is not in the window"
            of_laptop = size.name == "laptop" and state not in _NO_LAPTOP
            shown = of_laptop or (size.name == "desktop" and state in _DESKTOP)
            # before the rules are checked, which holds the page up so that a hand may be let go
            if (folder := os.environ.get("TELENANO_PICTURES")) and shown:
                keep(page.page.screenshot(), Path(folder) / f"{state}-{size.name}.png")
            check_rules(page, f"{state}, {size.name}")
    page.page.set_viewport_size({"width": 1366, "height": 768})

"""The gallery of delay in a real Chromium: the static page, and the tab of the view that shows the same."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from browser_page import Page, View, keep, needs_browser, open_page
from made_sessions import Made, hand_force_n
from page_walks import check_rules
from telenano_lab.studies.pages.gallery import FOLDER, page_of

pytestmark = [pytest.mark.browser, needs_browser]

FURTHER = pytest.mark.drawn(0.0, "services/viz_node/web/", "packages/telenano-lab/telenano_lab/studies/pages/")
SIZES = (("laptop", 1366, 768), ("desktop", 1920, 1080), ("tablet", 820, 1100), ("phone", 390, 844))
SAID = "document.querySelector('.gallery-said').textContent"
MOVE = """([law, place]) => {
  document.querySelector(".gallery select").value = law;
  const slider = document.querySelector(".gallery input");
  slider.value = place;
  slider.dispatchEvent(new Event("input"));
}"""


def move(page: Page, law: str, delay_ms: float) -> str:
    """Choose a law and a round trip; return what the page says of them."""
    page.page.evaluate(MOVE, [law, round(delay_ms / 5.0)])
    return str(page.value(SAID))


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=FURTHER)])
def test_the_static_page_shows_when_a_root_crosses_and_fits_every_window(
    chromium: Any, tmp_path: Path, scheme: str
) -> None:
    file = tmp_path / "gallery.html"
    file.write_text(page_of(json.loads((FOLDER / "gallery.json").read_text())))
    window = chromium.new_context(color_scheme=scheme)
    page = Page(window.new_page())
    page.page.goto(file.as_uri())
    growing = "[...document.querySelectorAll('.gallery circle.bad')].length"
    # the margin of theory, 45.0 ms, lies between these two
    assert move(page, "virtual_impedance", 40.0).startswith("stable")
    assert page.value(growing) == 0
    assert move(page, "virtual_impedance", 50.0).startswith("diverged")
    assert page.value(growing) == 2
    assert move(page, "wave", 200.0).startswith("stable")
    assert page.value(growing) == 0
    assert move(page, "passivity", 200.0).startswith("stable")
    assert "not linear" in page.value("document.querySelector('.gallery').textContent")
    move(page, "virtual_impedance", 60.0)
    for name, width, height in SIZES:
        page.page.set_viewport_size({"width": width, "height": height})
        assert page.value("document.documentElement.scrollWidth - innerWidth") <= 0, name
        check_rules(page, name)
        if (folder := os.environ.get("TELENANO_PICTURES")) and (name, scheme) == ("laptop", "light"):
            keep(page.page.screenshot(), Path(folder) / "gallery.png")
    assert page.faults == []
    window.close()


@FURTHER
def test_the_tab_of_the_view_shows_the_same(chromium: Any, tmp_path: Path) -> None:
    view = View(dict(os.environ), str(Made(tip_n=hand_force_n).write(tmp_path)))
    try:
        page = open_page(chromium, view.operator)
        page.click("#tab-gallery")
        page.until("document.querySelector('#gallery .gallery-said')?.textContent", "the gallery in its tab")
        document = json.loads((FOLDER / "gallery.json").read_text())
        for law in document["laws"]:
            said = move(page, law["law"], 120.0)
            assert law["cells"][24]["reason"] in said
        assert page.value("document.documentElement.scrollWidth - innerWidth") <= 0
        assert page.faults == []
        page.page.context.close()
    finally:
        view.close()

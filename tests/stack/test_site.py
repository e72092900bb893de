"""The documents as a site: built strictly, with its notebooks, and read in a real Chromium."""

import os
import re
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from browser_page import AXE, Page, needs_browser
from documents import ROOT, run
from test_gallery_page import MOVE, SAID

pytestmark = [pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(1500)]

PAGES = (
    "index.html", "packages.html", "unstable.html", "tutorial.html", "operating.html", "cli.html", "architecture.html",
    "notebooks/fig12_against_delay.html", "notebooks/experiment_table.html", "repository/examples/index.html",
    "repository/packages/telenano-lab/docs/gallery.html",
)  # fmt: skip
SIZES = ((1280, 800), (390, 844))
BROKEN = "[...document.images].filter((image) => !image.naturalWidth).map((image) => image.src)"
# a picture that is drawn larger than it is, without its frame
BLURRED = "[...document.images].filter((one) => one.clientWidth - 14 > one.naturalWidth).map((one) => one.src)"
READ = "axe.run(document.querySelector('article'), { runOnly: ['color-contrast', 'image-alt'] })"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, str(ROOT / "tests" / "doubles" / "site_pages.py"), str(folder / "built")]
    done = run(command, ROOT)
    assert done.returncode == 0, done.stderr
    return folder / "built"


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


class Quiet(SimpleHTTPRequestHandler):
    """Serves the site without a line for each request."""

    def log_message(self, *_: Any) -> None:
        pass


def test_every_link_and_picture_of_the_site_is_there(site: Path) -> None:
    pages = {path: path.read_text(encoding="utf-8") for path in site.rglob("*.html")}
    assert len(pages) > 60
    names = {path: set(re.findall(r'\bid="([^"]+)"', text)) for path, text in pages.items()}
    missing = []
    for path, text in pages.items():
        # without the data of scripts
        shown = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
        for target in re.findall(r'\b(?:href|src)="([^"]+)"', shown):
            if re.match(r"[a-z]+:|//", target) or path.name == "404.html":
                continue
            where, _, anchor = unquote(target).partition("#")
            there = (path.parent / where).resolve() if where else path
            if not there.is_file() or (anchor and there in names and anchor not in names[there]):
                missing.append(f"{path.relative_to(site)}: {target}")
    assert missing == []


def test_a_link_to_a_page_has_its_title_and_not_the_name_of_its_file(site: Path) -> None:
    for path in site.rglob("*.html"):
        assert re.findall(r"<a [^>]*>([\w./-]+\.md)</a>", path.read_text(encoding="utf-8")) == [], path


def test_no_page_names_a_file_of_another_server(site: Path) -> None:
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert re.findall(r'<(?:img|script|link rel="stylesheet")\b[^>]*(?:src|href)="https?:[^"]*"', text) == [], path
        # the theme's own script fetches the library for these from elsewhere
        assert 'class="mermaid"' not in text, path


@needs_browser
@pytest.mark.browser
def test_no_page_asks_another_server_for_anything(site: Path, address: str, chromium: Any) -> None:
    """Open every page, scripts and all, with a window that notes what it is asked for and answers nothing of others."""
    window = chromium.new_context()
    asked: list[str] = []

    def decide(route: Any) -> None:
        if route.request.url.startswith(address):
            route.continue_()
        else:
            asked.append(route.request.url)
            route.abort()

    window.route("**/*", decide)
    page = window.new_page()
    pages = sorted(path.relative_to(site) for path in site.rglob("*.html") if path.name != "404.html")
    assert len(pages) > 60
    for name in pages:
        page.goto(f"{address}/{name}", wait_until="load")
        page.wait_for_function("document.readyState === 'complete'")
    assert asked == []
    # the window does see what is asked for
    page.evaluate("fetch('http://elsewhere.invalid/library.js').catch(() => 0)")
    assert asked == ["http://elsewhere.invalid/library.js"]
    window.close()


def test_the_notebooks_have_what_they_print_and_draw(site: Path) -> None:
    for notebook in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        text = (site / "notebooks" / f"{notebook.stem}.html").read_text(encoding="utf-8")
        assert "Traceback" not in text
        assert list((site / "notebooks").glob(f"{notebook.stem}*.png"))
    assert "limit_cycle" in (site / "notebooks" / "fig12_against_delay.html").read_text(encoding="utf-8")


@needs_browser
@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_pages_fit_every_window_and_can_be_read(address: str, chromium: Any, scheme: str) -> None:
    for name in PAGES:
        for width, height in SIZES:
            window = chromium.new_context(color_scheme=scheme, viewport={"width": width, "height": height})
            page = Page(window.new_page())
            page.page.goto(f"{address}/{name}")
            page.until("document.readyState === 'complete'", "the page")
            assert page.value("document.documentElement.scrollWidth - innerWidth") <= 0, (name, width)
            assert page.value(BROKEN) == [], name
            assert page.value(BLURRED) == [], (name, width)
            page.value(f"{AXE.read_text()}; 0")
            found = page.value(READ)
            wrong = [
                (fault["id"], [(node["html"][:90], node["failureSummary"]) for node in fault["nodes"]])
                for fault in found["violations"]
            ]
            assert wrong == [], (name, width, scheme)
            if folder := os.environ.get("TELENANO_SCREENSHOTS"):
                shot = f"{name.replace('/', '-').removesuffix('.html')}-{width}-{scheme}.png"
                page.page.screenshot(path=str(Path(folder) / shot), full_page=True)
            assert page.faults == []
            window.close()


@needs_browser
@pytest.mark.browser
def test_the_slider_of_the_site_shows_when_a_root_crosses(address: str, chromium: Any) -> None:
    window = chromium.new_context()
    page = Page(window.new_page())
    page.page.goto(f"{address}/unstable.html")

    def move(law: str, delay_ms: float) -> str:
        page.page.evaluate(MOVE, [law, round(delay_ms / 5.0)])
        return str(page.value(SAID))

    growing = "[...document.querySelectorAll('.gallery circle.bad')].length"
    assert move("virtual_impedance", 45.0).startswith("stable")
    assert page.value(growing) == 0
    assert move("virtual_impedance", 50.0).startswith("diverged")
    assert page.value(growing) == 2
    assert move("wave", 200.0).startswith("stable")
    assert page.value(growing) == 0
    assert page.faults == []
    window.close()

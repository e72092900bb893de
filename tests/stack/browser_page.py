"""The page of the view in a real Chromium, as a person would use it."""

import importlib.util
import io
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import machine
import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ROOT = Path(__file__).resolve().parents[2]
PAGE_FOLDER = ROOT / "services" / "viz_node" / "web" / "dist"
_PACKAGES = ROOT / "services" / "viz_node" / "web" / "node_modules"
# of WebXR
EMULATOR = _PACKAGES / "iwer" / "build" / "iwer.min.js"
# what a screen reader and a reader with weak eyes need
AXE = _PACKAGES / "axe-core" / "axe.min.js"
# only keeps a broken page from holding the suite
PATIENCE_S = 60.0
# Of a rig beside a browser, which draws in software: at 1000 Hz the rig leaves it nothing of two processors, and the
# server of the page is held up for longer than the usual tenth of a second.
BESIDE_A_BROWSER = (*machine.LOWER_RATE, "--set", "haptic_node.operator.force_deadline_s=1")
# what a page has once it is connected with a rig or a recording
CONNECTED = "window.telenano?.store.streams.size"
# lines that the surface on the page has
FILLED = "telenano.view.surface.filled.filter(Boolean).length"
# a software renderer: the machines of tests have no graphics
_FLAGS: tuple[str, ...] = ("--no-sandbox", "--disable-background-networking")
_FLAGS += ("--disable-gpu", "--enable-unsafe-swiftshader")
# of several windows all but one would be given what the rig and the rest of the machine leave of the processors
_FLAGS += ("--disable-renderer-backgrounding", "--disable-backgrounding-occluded-windows")
_FLAGS += ("--disable-background-timer-throttling",)


def missing() -> str:
    """Return what this machine lacks for the tests in a browser; empty when it lacks nothing."""
    if CHROMIUM is None:
        return "there is no chromium"
    for package in ("playwright", "starlette", "uvicorn"):
        if importlib.util.find_spec(package) is None:
            return f"{package} is not installed"
    if not (PAGE_FOLDER / "index.html").is_file():
        return "the page has not been built: make page"
    return ""


def has(selector: str, text: str) -> str:
    """Return the expression for whether an element of the page has a text."""
    return f"document.querySelector({selector!r}).textContent.includes({text!r})"


def until(condition: Callable[[], Any], what: str) -> Any:
    """Wait until something holds, and return it."""
    end = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.05)
    return found


def keep(picture: bytes, path: Path) -> None:
    """Write a picture of a page with as many colours as it needs, which is a third of its bytes.

    The colours cover all that occur, because the most frequent ones would draw a thin curve in the colour of another,
    and their means give large areas their own.
    """
    from PIL import Image

    found = Image.open(io.BytesIO(picture)).convert("RGB")
    found.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE).save(path, optimize=True)


class View:
    """A `telenano view` and its addresses."""

    def __init__(self, environment: dict[str, str], *arguments: str, port: str = "0") -> None:
        command = [sys.executable, "-m", "telenano", "view", "--port", port, *arguments]
        self._process = subprocess.Popen(command, env=environment, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        # the addresses end with tokens, which are not written to a pipe
        lines = [self._process.stdout.readline() for _ in range(2)]
        if not lines[1]:
            self.close()
            pytest.fail(f"the server of the page gave no address; it ended with {self._process.returncode}")
        file = Path(lines[1].split()[-1])
        self.operator, self.observer, self.participant = (line.split()[1] for line in file.read_text().splitlines())

    @property
    def process_id(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        """End the server as a crash does: it says nothing to its pages."""
        self._process.kill()
        self._process.wait(20.0)

    def close(self) -> None:
        self._process.terminate()
        # An endpoint goes on sending for up to 20 s to a reader that is behind.
        self._process.wait(PATIENCE_S)
        assert self._process.stdout is not None
        self._process.stdout.close()


class Page:
    """An open page; what goes wrong in it is kept in `faults`."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.faults: list[str] = []
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("console", lambda line: self.faults.append(line.text) if line.type == "error" else None)
        page.set_default_timeout(PATIENCE_S * 1e3)

    def value(self, expression: str) -> Any:
        return self.page.evaluate(expression)

    def click(self, selector: str) -> None:
        """Press a button; without waiting for frames, which a machine without graphics draws a few of a second."""
        self.page.locator(selector).dispatch_event("click")

    def fill(self, selector: str, text: str) -> None:
        """Put a text into a field, wherever it is on the page."""
        self.until(f"document.querySelector({selector!r}) !== null", f"the field {selector}")
        self.page.locator(selector).evaluate("(field, text) => { field.value = text; }", text)

    def choose(self, selector: str, value: str) -> None:
        found = self.page.locator(selector)
        if found.locator(f"option[value='{value}']").count() == 0:
            # the last row of a short list shows the long one
            found.select_option("…", force=True)
        found.select_option(value, force=True)

    def press(self, down_mm: float) -> None:
        """Take hold of the virtual hand with the pointer, and mean to be so far below where the arm is."""
        pad = self.page.locator("#hand-pad")
        pad.evaluate("pad => pad.scrollIntoView()")
        box = pad.bounding_box()
        x, y = box["x"] + 120.0, box["y"] + 50.0
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        # the pad is 25 mm high
        self.page.mouse.move(x, y + down_mm / 25.0 * box["height"], steps=8)

    def lower_until(self, felt_n: float) -> None:
        """Hold the hand and lower it until so much is felt [N], as a person does with the buttons of what is next.

        A machine that is held up may lose the hand for a moment, and the page then says why: it is held again.
        """
        end = time.monotonic() + PATIENCE_S
        while not (felt := self.last("command", "tip_force")) >= felt_n:
            said = [self.page.inner_text(name) for name in ("#next-says", "#hand-text")]
            assert time.monotonic() < end, f"{felt} N are felt, and not {felt_n}; the page says {said}"
            self.value("telenano.cockpit.hand.holdHere(), telenano.cockpit.hand.lower(1e-3), 0")
            self.page.wait_for_timeout(500.0)

    def follow(self) -> None:
        """Let the tip follow the hand, again where a server that was held up has refused it, which the page says."""
        end = time.monotonic() + PATIENCE_S
        while self.fact("afm/state/slave", "mode") != "follow":
            assert time.monotonic() < end, f"the tip does not follow: {self.page.inner_text('#answers')!r}"
            self.answered(lambda: self.click("#mode-bilateral"))
            self.page.wait_for_timeout(1500.0)
        # Arming moves nothing: a tip that is withdrawn goes back by a choice of its own, and any input ends its way.
        end = time.monotonic() + PATIENCE_S
        commands = "telenano.cockpit.commands"
        while self.value(f"{commands}.wayBack !== undefined || {commands}.goingAt(performance.now()) !== undefined"):
            assert time.monotonic() < end, f"the tip does not go back: {self.page.inner_text('#answers')!r}"
            # again where it was refused, as above; what goes is left alone
            if self.value("document.querySelector('#go-back') !== null"):
                self.click("#go-back")
            self.page.wait_for_timeout(500.0)

    def fact(self, state: str, key: str) -> Any:
        return self.value(f"telenano.store.fact('{state}', '{key}')")

    def last(self, stream: str, column: str) -> float:
        found = self.value(f"telenano.store.last('{stream}', '{column}')")
        return float(found) if found is not None else float("nan")

    def until(self, expression: str, what: str) -> Any:
        try:
            return until(lambda: self.value(expression), what)
        except AssertionError as error:
            note = self.page.inner_text("#scene > .note")
            raise AssertionError(f"{error}; the page says {note!r} {self.banners()!r} {self.faults}") from None

    def answered(self, action: Callable[[], object]) -> str:
        """Do something and return the answer that the page shows to it."""
        self.value("document.querySelectorAll('.answer').forEach((shown) => shown.remove())")
        action()
        shown = self.page.locator(".answer.done, .answer.refused, .answer.unknown")
        until(shown.count, "an answer on the page")
        return str(shown.first.inner_text())

    def obeyed(self, action: Callable[[], object]) -> None:
        """Do something until it is acknowledged: again where a server that was held up has refused it, as it says."""
        end = time.monotonic() + PATIENCE_S
        while "acknowledged" not in (answer := self.answered(action)):
            assert "held up" in answer and time.monotonic() < end, answer

    def measured(self, curve: str) -> list[str]:
        """Return what stands beside the name of a curve in the table of the cursors: A, B, B - A, peak to peak, …"""
        rows = self.page.locator(".measures tbody tr").all()
        found = {row.locator("th").inner_text(): row.locator("td").all_inner_texts() for row in rows}
        return found.get(curve, ["–"] * 6)

    def banners(self) -> str:
        return str(self.page.inner_text("#banners"))

    def picture(self, name: str) -> None:
        """Keep a picture of the page where TELENANO_PICTURES names a folder, once what was last changed is drawn."""
        drawn = self.value("telenano.view.invalidate() || telenano.view.frames")
        self.until(f"telenano.view.frames > {drawn}", "a drawn scene")
        if folder := os.environ.get("TELENANO_PICTURES"):
            keep(self.page.screenshot(), Path(folder) / f"{name}.png")


@contextmanager
def browser() -> Iterator[Any]:
    """Return a browser that is closed at the end."""
    from playwright.sync_api import sync_playwright

    # as anybody would start it: it draws in software, and not ahead of the rig's launcher and server of the page
    machine.usual_priority()
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=list(_FLAGS))
        machine.keep_our_turn()
        try:
            yield found
        finally:
            found.close()


def open_page(found: Any, address: str, *, headset: bool = False, ready: str = CONNECTED, **context: Any) -> Page:
    """Open an address in a window of its own until it is `ready`, where asked with an emulated `headset`."""
    view = {"viewport": {"width": 1360, "height": 850}, **context}
    window = found.new_context(**view)
    if headset:
        # one script, because the order of several is not promised; in the place of the WebXR of the browser itself
        device = "globalThis.headset = new IWER.XRDevice(IWER.metaQuest3);"
        window.add_init_script(f"{EMULATOR.read_text()}\n{device} headset.installRuntime({{forceInstall: true}});")
    page = Page(window.new_page())
    page.page.goto(address, timeout=PATIENCE_S * 1e3, wait_until="commit")
    page.until(ready, "a page that is connected")
    return page


needs_browser = pytest.mark.skipif(bool(missing()), reason=missing() or "everything is there")

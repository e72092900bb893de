"""Several pages of several people: more than may be, those that are not admitted, and one whose server is gone."""

import asyncio
import os
import re
import time
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import msgpack
import numpy as np
import pytest
from browser_page import FILLED, Page, View, needs_browser, open_page, until
from page_walks import step
from scanned_image import scanned
from stack_rig import CONSTANT_PUSH, Rig

from services.viz_node.hub import MOST_PAGES
from services.viz_node.requests import PROTOCOL
from telenano.recording.reader import Recording
from telenano.serving.access import Role

pytestmark = pytest.mark.timeout(600)
MORE = 4
PAGES, WATCHED_S, ROUNDS = MOST_PAGES[Role.OBSERVER] + MORE, 30.0, 3
# A round after the first one may grow the memory by this; in the first, caches and the allocator find their size.
MOST_GROWTH_BYTES = 10_000_000


class Watched(NamedTuple):
    """What one page was sent."""

    frames: int
    snapshots: int
    refused: str


async def watch(address: str) -> Watched:
    """Open a page, say who it is, and read for a while as a browser does."""
    import websockets

    parts = urlsplit(address)
    origin: Any = f"http://{parts.netloc}"
    frames, snapshots, refused = 0, 0, ""
    async with websockets.connect(f"ws://{parts.netloc}/bus", origin=origin, max_size=None) as page:
        await page.send(msgpack.packb({"k": "hello", "protocol": PROTOCOL, "token": parts.fragment}))
        end = time.monotonic() + WATCHED_S
        while time.monotonic() < end and not refused:
            frame = msgpack.unpackb(await asyncio.wait_for(page.recv(), 20.0), strict_map_key=False)
            frames += 1
            snapshots += frame["k"] == "snapshot"
            refused = frame["text"] if frame["k"] == "refused" else ""
    return Watched(frames, snapshots, refused)


async def watch_all(address: str) -> list[Watched]:
    return await asyncio.gather(*(watch(address) for _ in range(PAGES)))


def resident_bytes(process_id: int) -> int:
    lines = Path(f"/proc/{process_id}/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


def loop_ages_s(recording: Recording, begin_ns: int, end_ns: int) -> "np.ndarray[Any, Any]":
    """Return the age of the hand's sample behind each command in a span [s]."""
    states = [message.fields() for message in recording.messages(["haptic/state"])]
    ages = [
        (state["answered_at_ns"] - state["answered_t_ns"]) * 1e-9
        for state in states
        if begin_ns <= state["t_ns"] < end_ns and state["answered_t_ns"] > 0
    ]
    return np.array(ages)


@pytest.mark.endurance
def test_pages_hold_up_no_loop_and_leave_no_memory_behind(rig: Rig) -> None:
    rig.start("--duration", "900", "--set", CONSTANT_PUSH)
    rig.wait_until(rig.running, "a running session")
    sizes, spans = [], []
    with closing(View(rig.environment)) as view:
        # nobody watches
        begin_ns = time.time_ns()
        time.sleep(WATCHED_S)  # what is measured is a span
        alone = begin_ns, time.time_ns()
        for _ in range(ROUNDS):
            begin_ns = time.time_ns()
            watched = asyncio.run(watch_all(view.observer))
            spans.append((begin_ns, time.time_ns()))
            refused = [page.refused for page in watched if page.refused]
            assert len(refused) == MORE and all("made room for another one" in text for text in refused), refused
            # each of the others is told what changes, and none is so far behind that it has to begin anew
            admitted = [page for page in watched if not page.refused]
            assert all(page.snapshots == 1 for page in admitted), watched
            assert min(page.frames for page in admitted) > 5.0 * WATCHED_S, watched
            sizes.append(resident_bytes(view.process_id))
    code, summary, err = rig.stop()
    assert code == 0, err
    assert summary["recording"]["complete"], summary["recording"]
    assert sizes[-1] - sizes[0] < (ROUNDS - 1) * MOST_GROWTH_BYTES, sizes
    recording = Recording(rig.out / "session.mcap")
    undisturbed = loop_ages_s(recording, *alone)
    for span in spans:
        ages = loop_ages_s(recording, *span)
        assert np.median(ages) < 1.5 * np.median(undisturbed)
        # The loop gives as many answers a second as without the pages.
        rate = ages.size / (span[1] - span[0]) / (undisturbed.size / (alone[1] - alone[0]))
        assert rate > 0.98, rate


@pytest.mark.browser
@needs_browser
def test_pages_that_are_not_admitted_say_what_to_do_and_a_lost_server_is_found_again(
    chromium: Any, tmp_path: Path
) -> None:
    environment = {**os.environ, "TELENANO_VIEW_OPERATOR_TOKEN": "operator-of-the-tests"}
    recording = str(scanned(tmp_path))
    view = View(environment, recording)
    try:
        with step("a page of an older version"):
            check_old_page(chromium, view)
        with step("a token that is none"):
            page = open_refused(chromium, f"{view.operator.partition('#')[0]}#not-the-token-0123")
            wrong = "the token is wrong: open the address that telenano view --addresses prints"
            until(lambda: wrong in page.banners(), "what is wrong")
            assert page.value("telenano.store.streams.size") == 0
            page.page.context.close()
        with step("a token leaves the address bar, and another of the same tab replaces it"):
            page = open_page(chromium, view.operator)
            check_token(page, view)
            page.page.context.close()
        with step("the server is gone"):
            page = open_page(chromium, view.operator)
            view.kill()
            until(lambda: "DISCONNECTED" in page.banners(), "the banner of a lost server")
            answer = page.answered(lambda: page.click("#play"))
            assert "there is no connection to the server" in answer
            view.close()
        with step("the server is back"):
            port = view.operator.partition("/#")[0].rpartition(":")[2]
            view = View(environment, recording, port=port)
            until(lambda: "REPLAY" in page.banners(), "a page that is connected again")
            assert "DISCONNECTED" not in page.banners()
            page.until(f"{FILLED} > 0", "what the server sends")
            assert "acknowledged" in page.answered(lambda: page.click("#play"))
            page.page.context.close()
    finally:
        view.close()


def open_refused(window: Any, address: str) -> Page:
    """Open an address at which the page is not admitted, in a browser or a window of it, until it says something."""
    page = Page(window.new_page())
    page.page.goto(address, wait_until="commit")
    page.page.wait_for_selector("#banners .banner", state="attached")
    return page


def check_token(page: Page, view: View) -> None:
    base, _, token = view.operator.partition("#")
    assert page.value("location.href") == base
    assert token not in str(page.value("JSON.stringify({...localStorage})"))
    page.page.reload()
    page.until("window.telenano?.store.role === 'operator'", "the role after a reload")
    with page.page.expect_event("load"):
        page.page.evaluate("token => { location.hash = token; }", view.observer.partition("#")[2])
    page.until("window.telenano?.store.role === 'observer'", "the role of the other token")
    assert page.value("location.href") == base


def check_old_page(chromium: Any, view: View) -> None:
    """Open the page as one of an older version would be: it says what to do, and is admitted to nothing."""
    window = chromium.new_context()
    replaced: list[int] = []

    def older(route: Any) -> None:
        script = route.fetch().text()
        replaced.append(script.count(f"protocol:{PROTOCOL}"))
        route.fulfill(body=script.replace(f"protocol:{PROTOCOL}", "protocol:0"), content_type="text/javascript")

    # The script of the worker has headers of its own, without which the browser refuses it.
    window.route(re.compile(r"/assets/(?!.*worker)[^/]*\.js"), older)
    page = open_refused(window, view.operator)
    until(lambda: "load the page again" in page.banners(), "what an old page says")
    assert sum(replaced) == 1
    assert page.value("telenano.store.streams.size") == 0
    window.close()

"""The page behind a proxy: in a sub-folder it finds its socket, and where it is slow it says so and its force fades."""

import re
import threading
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from browser_page import PAGE_FOLDER, needs_browser, open_page, until
from slow_proxy import SlowProxy

from services.viz_node.page_hand import HAND_FADE_S, HAND_FRESH_S
from telenano.testing import free_ports
from telenano.testing.filled_messages import examples
from telenano.wire.topics import TOPICS

pytestmark = [pytest.mark.browser, needs_browser, pytest.mark.timeout(300)]

FOLDER, TOKEN = "lab/rig", "operator-token-0123"


def rig_that_follows() -> list[Any]:
    """Return what hand and instrument say of a session in which the tip follows."""
    from services.viz_node.feed import seen

    said = []
    for topic, src, changes in (
        ("haptic/state", "haptic_node@master", {"session_s": 1.0}),
        ("afm/state", "afm_node@slave", {"mode": "follow"}),
    ):
        now_ns = time.time_ns()
        message = msgspec.structs.replace(examples(TOPICS[topic])["ordinary"], t_ns=now_ns, src=src, **changes)
        said.append(seen(topic, src, now_ns, message))
    return said


@pytest.fixture
def forces() -> Iterator[tuple[int, list[tuple[float, float]]]]:
    """Serve a page at a port; yield that, and each force that comes to the device: when [s], and how much down [N]."""
    from lone_page_server import LonePageServer

    from telenano.serving.access import Access

    found: list[tuple[float, float]] = []
    (port,) = free_ports(1)
    access = Access(TOKEN, "observer-token-0123")

    def push(force_n: float, across_n: tuple[float, float]) -> None:
        found.append((time.monotonic(), force_n))

    server = LonePageServer(push, access, host="127.0.0.1", port=port, page=PAGE_FOLDER, news=rig_that_follows)
    thread = threading.Thread(target=server.run)
    thread.start()
    yield port, found
    server.end()
    thread.join()


def test_a_page_in_a_sub_folder_has_the_hand_and_says_when_it_is_too_slow(
    forces: tuple[int, list[tuple[float, float]]], chromium: Any
) -> None:
    port, pushed = forces
    with SlowProxy(port, FOLDER) as proxy:
        page = open_page(chromium, proxy.address(f"#{TOKEN}"))
        assert page.value("location.pathname") == f"/{FOLDER}/"
        assert proxy.refused == 0, "the page asks for something outside of its folder"
        page.press(10.0)
        until(lambda: pushed and pushed[-1][1] > 0.1, "the force of the page")
        page.until("document.querySelector('#hand-pad').dataset.slow === 'false'", "a page that is not slow")
        proxy.delay_s = HAND_FRESH_S + HAND_FADE_S
        shown = until(lambda: re.search(r"Too slow: .*", page.page.inner_text("body")), "that the page is too slow")
        page.picture("too_slow")
        behind_ms = re.search(r"is (\d+) ms behind, and its force fades", shown[0])
        assert behind_ms is not None and int(behind_ms[1]) >= 1e3 * HAND_FRESH_S, shown[0]
        until(lambda: time.monotonic() - pushed[-1][0] > HAND_FADE_S or pushed[-1][1] < 0.01, "a force that has faded")
        proxy.delay_s = 0.0
        page.until("document.querySelector('#hand-pad').dataset.slow === 'false'", "a page that is no longer slow")
        page.page.mouse.up()
        assert page.faults == []

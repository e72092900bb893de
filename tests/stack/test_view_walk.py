"""The first walk of docs/view.md: image and touch the sample, raise the delay until it oscillates, change the law."""

import logging
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from browser_page import BESIDE_A_BROWSER, FILLED, PATIENCE_S, Page, View, browser, needs_browser, open_page
from stack_rig import Rig

from telenano.analysis.verdict import Verdict, judge

_LOG = logging.getLogger(__name__)
pytestmark = [pytest.mark.browser, pytest.mark.endurance, needs_browser]

# what docs/view.md tells a newcomer to type
STIFFNESS = "afm_node.cantilever.stiffness_n_per_m=4"
DELAYS_MS = (200, 300)
LAW = "wave"
# alpha_f of the scenario
FORCE_SCALE = 1e8
DEEP_MM, PUSH_MM, AGAIN_MM = 14.0, 6.0, 8.0
# five swings
WATCHED_S = 6.0
# with which hand and tip press in steady state
HELD_N = 1.0


class Watched(NamedTuple):
    """The force on the tip at the hand's scale over a while: what became of it, how far it went, and its mean [N]."""

    verdict: Verdict
    peak_to_peak_n: float
    mean_n: float


def watched(rig: Rig) -> Watched:
    """Watch for a while, and judge as the reports do."""
    begin_ns = time.time_ns()
    end_ns = begin_ns + round(WATCHED_S * 1e9)
    rig.wait_until(lambda: rig.recording().messages("afm/state")[-1].log_ns > end_ns, "what is watched")
    rows = [row.decode() for row in rig.recording().messages("afm/state", begin_ns)]
    time_s = np.array([1e-9 * (row.t_ns - rows[0].t_ns) for row in rows])
    force_n = FORCE_SCALE * np.array([row.tip_force_n[2] for row in rows])
    verdict = judge(time_s, force_n, HELD_N)
    found = Watched(verdict, float(np.ptp(force_n)), float(force_n.mean()))
    _LOG.info("%.1f s: %s", time_s[-1], found)
    return found


def held(rig: Rig, most_n: float) -> Watched:
    """Wait until the force moves by no more than so much [N]."""
    end = time.monotonic() + PATIENCE_S
    while (found := watched(rig)).peak_to_peak_n > most_n:
        assert time.monotonic() < end, f"waited in vain for a force that stands: {found}"
    return found


def test_a_newcomer_images_touches_delays_and_holds(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    try:
        rig.start("--duration", "300", "--no-view", "--set", STIFFNESS, *BESIDE_A_BROWSER, scenario="image")
        rig.wait_until(rig.running, "a running session")
        view = View(rig.environment)
        try:
            with browser() as chromium:
                walk(rig, open_page(chromium, view.operator))
        finally:
            view.close()
    finally:
        rig.close()


def walk(rig: Rig, page: Page) -> None:
    page.until("telenano.store.rings.get('tip')?.length > 200", "curves on the page")
    page.until("document.querySelectorAll('#law-name option').length > 1", "the forms of the law")
    for key, value in {"pixels": "32", "lines": "16", "dwell_s": "12"}.items():
        page.fill(f"#program-scan-{key}", value)
    assert "acknowledged" in page.answered(lambda: page.click("#program-scan"))
    page.until(f"{FILLED} === 16", "the whole image")
    page.until("telenano.store.fact('afm/state/slave', 'mode') === 'retracted'", "a tip that is away")
    page.follow()
    page.fill("#tip-x", "0")
    page.fill("#tip-y", "0")
    assert "acknowledged" in page.answered(lambda: page.click("#tip-go"))
    page.click("#hand-keep")
    page.press(DEEP_MM)
    # the pointer is free, and the hand stays where it is
    page.page.mouse.up()
    rig.wait_until(lambda: rig.newest("haptic/command").force_n[2] > 0.1, "the sample felt")
    still = held(rig, 0.1 * HELD_N)
    assert still.mean_n > 0.5 * HELD_N
    for delay_ms in DELAYS_MS:
        page.fill("#delay", str(delay_ms))
        assert "acknowledged" in page.answered(lambda: page.click("#delay-set"))
        # a loop at rest needs a push, and what comes of it begins small
        page.press(PUSH_MM)
        page.page.mouse.up()
        watched(rig)
        swinging = watched(rig)
        if swinging.peak_to_peak_n > 2.0 * HELD_N:
            break
    assert swinging.peak_to_peak_n > 2.0 * HELD_N, swinging
    assert swinging.verdict.kind in ("diverged", "limit_cycle"), swinging
    assert "DELAYED" in page.banners()
    page.picture("oscillates")
    assert "acknowledged" in page.answered(lambda: page.choose("#law-name", LAW))
    rig.wait_until(lambda: rig.newest("teleop/backward").law == LAW, "the law on the bus")
    # hand and tip stand where the swing had them, so the sample may be higher or lower now: press again
    page.press(AGAIN_MM)
    page.page.mouse.up()
    again = held(rig, 0.1 * swinging.peak_to_peak_n)
    assert again.mean_n > 0.2 * HELD_N
    assert rig.newest("afm/state").in_contact
    assert rig.newest("link/status").forward.delay_mean_s == pytest.approx(1e-3 * delay_ms, rel=0.1)
    page.picture("holds")
    page.click("#hand-keep")
    rig.wait_until(lambda: rig.newest("haptic/state").operator_force_n[2] == 0.0, "a hand that has let go")
    assert page.faults == []

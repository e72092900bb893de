"""A participant's page in a real Chromium, without a rig: in each window a trial shows the hand and what answers it."""

import os
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from browser_page import PATIENCE_S, Page, View, keep, needs_browser
from telenano_lab.experiments.bus import ExperimentBus
from telenano_lab.experiments.extend import choice
from telenano_lab.experiments.tasks import TASKS

from telenano.settings import DEFAULT_SITE_FILE

pytestmark = [pytest.mark.browser, needs_browser]

SIZES = (("laptop", 1366, 768), ("tablet", 820, 1100), ("phone", 390, 844), ("low", 844, 390))
STAGE = "document.body?.dataset.stage"
SHOWN = """(id) => {
  const box = document.getElementById(id).getBoundingClientRect();
  const at = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
  return box.width >= 44 && box.height >= 44 && at !== null && at.closest("#" + id) !== null;
}"""
# the answer of the task, the pad of the hand, and the stop
NEEDED = ("during-felt", "hand-pad", "estop")


def test_a_trial_shows_hand_answer_and_stop_in_every_window(chromium: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    task = TASKS["touch_and_hold"]
    p = task.parameters.model_validate({})
    with tempfile.TemporaryDirectory(prefix="tnp-") as sockets:
        monkeypatch.setenv("TELENANO_RUNTIME_DIR", sockets)
        with closing(View(dict(os.environ))) as view, ExperimentBus(DEFAULT_SITE_FILE) as bus:
            page = Page(chromium.new_page())
            page.page.goto(view.participant, wait_until="commit")
            question = (choice("felt", "Press at the touch", ("I feel it",)),)
            cue = bus.cue(
                "trial", task.title, course=task.target(p, 0), band=task.band(p), remaining_s=600.0, questions=question
            )
            bus.wait(cue, PATIENCE_S, lambda answers: page.value(STAGE) == "trial")
            assert page.value(STAGE) == "trial"
            for name, width, height in SIZES:
                page.page.set_viewport_size({"width": width, "height": height})
                assert [each for each in NEEDED if not page.page.evaluate(SHOWN, each)] == [], name
                assert page.value("document.documentElement.scrollWidth - innerWidth") <= 0, name
                if folder := os.environ.get("TELENANO_PICTURES"):
                    keep(page.page.screenshot(), Path(folder) / f"participant-{name}.png")
            assert page.faults == []
            page.page.close()

"""A panel that a stranger wrote without a build step, in a real Chromium: it is there when what it shows is.

The package is the one of docs/extending/io.md, word by word.
"""

import os
import re
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from browser_page import ROOT, View, keep, missing, open_page

from telenano.testing import environment_with, install_package

pytestmark = [pytest.mark.browser, pytest.mark.skipif(bool(missing()), reason=missing())]

DOCUMENT = ROOT / "docs" / "extending" / "io.md"
RECORD = """
import sys
from pathlib import Path
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.runtime.bus.publisher import NullPublisher
from telenano.timing.clock import SystemClock
from telenano.wire.codec import accept

publisher, sent = NullPublisher(SystemClock(), "experiment@master"), []
publisher.send = lambda topic, payload: sent.append((topic, payload))
for speed in (3.5, 4.25):
    publisher.publish("session/event", id="", kind="mark", level="info", text="a mark", data={})
    publisher.publish("wind/speed", speed_m_per_s=speed)
writer = RecordingWriter.create("recorder@master", RecorderConfig(directory=Path(sys.argv[1])))
channels = {topic: writer.channel(topic, "experiment@master", "master") for topic in ("session/event", "wind/speed")}
for topic, payload in sent if sys.argv[2] == "wind" else sent[::2]:
    message = accept(topic, payload)
    writer.write(channels[topic], message.t_ns, message.t_ns, message.seq, payload)
writer.finish()
"""


def documented(language: str, word: str) -> str:
    """Return the block of a language in the document that has a word."""
    blocks = re.findall(rf"```{language}\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    (found,) = [block for block in blocks if word in block]
    return found


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    site = tmp_path_factory.mktemp("site")
    files = {
        "__init__.py": "",
        "messages.py": documented("python", "WIND_SPEED = Topic("),
        "panel.py": documented("python", "PANEL = Panel("),
        "web/wind.js": documented("js", "export function make"),
        "web/broken.js": "export function make() { throw new Error('no such sensor'); }",
        "broken.py": "from my_package.panel import PANEL\n"
        "BROKEN = PANEL._replace(id='broken', title='Broken', module=PANEL.module.with_name('broken.js'))\n",
    }
    entries = {
        "topics": {"wind_speed": "my_package.messages:WIND_SPEED"},
        "panels": {"wind": "my_package.panel:PANEL", "broken": "my_package.broken:BROKEN"},
    }
    install_package(site, "my_package", files, entries)
    return site


def shown(chromium: Any, site: Path, folder: Path, what: str) -> Any:
    """Show a recording, and yield nothing but the facts of the page."""
    found = environment_with(site, TELENANO_RUNTIME_DIR=str(folder))
    subprocess.run([sys.executable, "-c", RECORD, str(folder / what), what], check=True, env=found)
    with closing(View(found, str(folder / what / "session.mcap"))) as view:
        page = open_page(chromium, view.operator)
        if what == "wind":
            page.until("document.querySelector('#wind') !== null", "the panel of the package")
            # in a narrow window it is a tab, and only what is seen is written
            page.value("document.querySelector('#tab-wind')?.click()")
            page.until("/m.s/.test(document.querySelector('#wind').textContent)", "the speed of the wind")
            page.until("/no such sensor/.test(document.querySelector('#answers').textContent)", "what failed")
        else:
            page.until("telenano.store.events.length > 0", "an event of the recording")
        if folder_of_pictures := os.environ.get("TELENANO_PICTURES"):
            keep(page.page.screenshot(), Path(folder_of_pictures) / f"stranger-{what}.png")
        text = page.value("document.querySelector('#wind')?.textContent ?? ''")
        ids = page.value("[...document.querySelectorAll('section.panel')].map((panel) => panel.id)")
        faults = page.faults
        page.page.context.close()
    return text, ids, faults


def test_a_stranger_brings_a_panel_in_thirty_lines(chromium: Any, site: Path, tmp_path: Path) -> None:
    lines = [
        line for file in ("panel.py", "web/wind.js") for line in (site / "my_package" / file).read_text().split("\n")
    ]
    assert len([line for line in lines if line.strip()]) <= 30
    text, ids, faults = shown(chromium, site, tmp_path, "wind")
    assert "4.25 m/s" in text or "3.50 m/s" in text
    # one that fails is told of and is not there; nothing else is wrong
    assert "wind" in ids and "broken" not in ids and "events" in ids
    assert faults == []


@pytest.mark.drawn(0.0, "services/viz_node/", "telenano/serving/", "telenano/extend/")
def test_without_what_it_shows_it_is_not_there(chromium: Any, site: Path, tmp_path: Path) -> None:
    text, ids, faults = shown(chromium, site, tmp_path, "calm")
    assert text == "" and "wind" not in ids and faults == []

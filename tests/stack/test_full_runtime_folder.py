"""A folder of sockets that fills up while a page has the hand: the loop, the page and an emergency stop go on."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import machine
import pytest
from browser_page import View
from ledger import record
from page_client import Client
from stack_rig import Rig

from telenano.testing import disk_of

pytestmark = [
    pytest.mark.stack,
    pytest.mark.timeout(300),
    pytest.mark.drawn(0.0, "telenano/console/", "telenano/files/", "services/viz_node/"),
]
# A holder of whom nothing was heard for a second would have lost the hand [s].
FULL_S = 4.0


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Rig]:
    """Return a rig whose sockets are on a small disk of its own."""
    rig = Rig(tmp_path)
    with disk_of(rig.sockets, "2m"), closing(rig):
        yield rig
    rig.sockets.rmdir()


def fill(folder: Path) -> Path:
    filler = folder / "filler"
    with filler.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(4096))
        except OSError:
            return filler


def test_the_loop_the_page_and_a_stop_go_on_where_the_folder_of_sockets_is_full(small: Rig) -> None:
    rig = small
    rig.start("--duration", "300", *machine.LOWER_RATE, scenario="touch")
    rig.wait_until(rig.running, "a running session")
    with closing(View(rig.environment)) as view, ExitStack() as stack:
        page = Client(stack, view.operator)
        taken = page.ask(k="lease", action="take")
        assert taken["ok"], taken
        filler = fill(rig.sockets)
        end_s = time.monotonic() + FULL_S
        while time.monotonic() < end_s:
            page.here()
            time.sleep(0.1)
        # the page still has the hand: what asks for its lease is carried out
        page.here()
        number = taken["lease"]["number"]
        armed = page.ask(k="command", command="arm", target="haptic_node", parameters={}, lease=number)
        assert "earlier lease" not in armed["text"] and "holds control" not in armed["text"], armed
        for words in (("session", "arm", "--take"), ("view", "--for", "Tina", "--role", "operator")):
            done = rig.telenano(*words)
            assert done.returncode == 1, (words, done)
            assert str(rig.sockets) in done.stderr and "No space left on device" in done.stderr, done.stderr
            assert "standard output" not in done.stderr and "Traceback" not in done.stderr
        assert rig.telenano("status", "--duration", "1").returncode in (0, 1)
        stopped = rig.telenano("estop")
        assert stopped.returncode == 0, stopped.stderr
        again = page.ask(k="estop")
        assert again["ok"], again
        assert view.process_id and not view._process.poll()
        filler.unlink()
        page.here()
        let_go = page.ask(k="lease", action="let_go", lease=number)
        assert let_go["ok"], let_go
    happened = f"kept for {FULL_S:g} s; others refused with the path; both devices stopped"
    record("the folder of sockets is full while a page has the hand", happened)
    code, _, err = rig.stop()
    assert code in (0, 1, 3), err
    assert "Traceback" not in err

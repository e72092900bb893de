"""Who has the hand of a rig that runs, while the page, its server and the hand are stopped and killed."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import machine
import pytest
from browser_page import View
from ledger import record
from stack_rig import Rig

from telenano.console.lease import Lease
from telenano.console.lease_register import LeaseRegister

pytestmark = [
    pytest.mark.stack,
    pytest.mark.timeout(600),
    pytest.mark.drawn(0.0, "telenano/console/", "services/viz_node/", "services/haptic_node/"),
]
PAGE = Path(__file__).parent / "pressing_page.py"
HAND = "haptic_node@master"
AWAY = ("retracting", "retracted")


_ATTEMPTS = 6


@pytest.fixture
def closing_all() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


class Pressing:
    """A page of a person in a process of its own, which has the hand and presses."""

    def __init__(self, rig: Rig, address: str, log: Path) -> None:
        self._log = log
        with log.open("w") as out:
            self._process = subprocess.Popen([sys.executable, str(PAGE), address], stdout=out, env=rig.environment)

    def told(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._log.read_text().splitlines() if line.endswith("}")]

    def has_it(self) -> bool:
        """Return whether the page believes that it has the hand."""
        lease = [each for each in self.told() if "mine" in each or "closed" in each]
        return bool(lease) and lease[-1].get("mine") is True

    def has_lost_it(self) -> bool:
        """Return whether it had the hand and has not any more, as where its server stood still for longer."""
        return any(each.get("mine") for each in self.told()) and not self.has_it()

    def send(self, number: int) -> None:
        os.kill(self._process.pid, number)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def holder(register: LeaseRegister) -> str:
    lease: Lease = register.look()
    return "" if lease.holder is None else lease.holder.name


def newest(rig: Rig, topic: str) -> dict[str, Any]:
    messages = rig.recording().messages(topic)
    return dict(messages[-1].fields()) if messages else {}


def presses(rig: Rig) -> bool:
    force = newest(rig, "operator/force")
    return force.get("by") == "Tina" and force["force_n"][2] < 0.0


def follows(rig: Rig) -> bool:
    return presses(rig) and newest(rig, "afm/state")["mode"] == "follow"


def settled(rig: Rig, page: Pressing) -> bool:
    return page.has_lost_it() or (page.has_it() and follows(rig))


def test_who_vanishes_loses_the_hand_and_the_tip_is_withdrawn_and_a_hand_that_is_started_anew_asks_nobody(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, closing_all: ExitStack
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(rig.sockets))
    rig.start("--duration", "600", *machine.LOWER_RATE, scenario="touch")
    rig.wait_until(rig.running, "a running session")
    register = LeaseRegister()
    stack = closing_all
    views = [View(rig.environment)]
    stack.callback(lambda: views[-1].close())
    given = rig.telenano("view", "--for", "Tina", "--role", "operator")
    assert given.returncode == 0, given.stderr
    token = given.stdout.strip().rpartition("#")[2]

    @contextmanager
    def pressing(name: str) -> Iterator[Pressing]:
        for attempt in range(_ATTEMPTS):
            armed = rig.telenano("session", "arm", "--target", "afm_node")
            assert armed.returncode == 0, armed.stdout + armed.stderr
            address = views[-1].operator.partition("#")[0]
            page = Pressing(rig, f"{address}#{token}", tmp_path / f"{name}-{attempt}.log")
            stack.callback(page.close)
            try:
                rig.wait_until(partial(settled, rig, page), "a tip that follows")
                if page.has_it():
                    yield page
                    return
            finally:
                page.close()
            machine.note(f"{name}: the hand was taken again, because the machine held up the server of the page")
        pytest.skip("the machine held up the server of the page again and again")

    def lost(fault: str, cause: Callable[[Pressing], None], page: Pressing) -> None:
        begun = time.monotonic()
        cause(page)
        rig.wait_until(lambda: holder(register) != "Tina", f"a lease that is lost: {fault}")
        lost_s = time.monotonic() - begun
        rig.wait_until(lambda: newest(rig, "afm/state")["mode"] in AWAY, f"a tip that is withdrawn: {fault}")
        record(fault, f"lost after {lost_s:.1f} s, and the tip was withdrawn")

    with pressing("killed") as page:
        lost("the page that has the hand is killed", lambda page: page.send(signal.SIGKILL), page)
    with pressing("stopped") as page:
        lost("the page that has the hand stands still", lambda page: page.send(signal.SIGSTOP), page)
        page.send(signal.SIGCONT)
        # what it had sent before, and sends now, is under an earlier lease
        rig.wait_until(lambda: not page.has_it(), "a page that knows that it has lost the hand")
        assert holder(register) == ""
    with pressing("server stopped") as page:
        server = views[-1].process_id
        os.kill(server, signal.SIGSTOP)
        try:
            # the others see that nobody has it, though its server says nothing
            rig.wait_until(lambda: holder(register) == "", "a lease that is lost: the server stands still")
        finally:
            os.kill(server, signal.SIGCONT)
        rig.wait_until(lambda: not page.has_it(), "a page that knows that it has lost the hand")
        rig.wait_until(lambda: newest(rig, "afm/state")["mode"] in AWAY, "a tip that is withdrawn by a late server")
        record("the server of the page stands still while a page has the hand", "lost, and the tip was withdrawn")
    with pressing("server killed") as page:

        def start_again(page: Pressing) -> None:
            views[-1].kill()
            views[-1].close()
            views.append(View(rig.environment))

        lost("the server of the page is killed while a page has the hand", start_again, page)
        rig.wait_until(lambda: not page.has_it(), "a page whose connection is gone")
    with pressing("hand") as page:
        number = register.look().number
        stopped = rig.process_of(HAND)
        assert stopped is not None
        os.kill(stopped, signal.SIGSTOP)
        time.sleep(1.5)
        os.kill(stopped, signal.SIGCONT)
        rig.kill(HAND)
        rig.wait_until(lambda: rig.process_of(HAND) not in (None, stopped), "a hand that was started again")
        # the lease is the page's all the while, and an emergency stop asks for none
        assert (holder(register), register.look().number, page.has_it()) == ("Tina", number, True)
        refused = rig.telenano("session", "set", "--target", "controller", "law=wave")
        assert refused.returncode != 0 and "Tina holds control" in refused.stderr
        stop = rig.telenano("estop")
        assert stop.returncode == 0, stop.stdout + stop.stderr
        rig.wait_until(lambda: newest(rig, "afm/state")["mode"] == "estop", "an emergency stop beside the lease")
        assert register.look().number == number
        record("the hand stands still and is killed while a page has it", "the lease is the page's all the while")
    code, _, err = rig.stop()
    assert code in (0, 1, 3), err
    assert "Traceback" not in err

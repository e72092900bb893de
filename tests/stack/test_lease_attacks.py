"""A pupil whose page was changed attacks a rig that runs: all that it asks is refused, and the loop goes on."""

import time
from contextlib import ExitStack, closing, suppress
from typing import Any
from urllib.parse import urlsplit

import machine
import msgpack
import pytest
from browser_page import View
from stack_rig import Rig
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from services.console.lease_register import LeaseRegister

pytestmark = [pytest.mark.stack, pytest.mark.timeout(300)]
ATTACK_S, ATTEMPTS = 5.0, 4


class Client:
    """A page that sends what its person wants and not what it shows."""

    def __init__(self, stack: ExitStack, address: str) -> None:
        parts = urlsplit(address)
        origin: Any = f"http://{parts.netloc}"
        self.socket = stack.enter_context(connect(f"ws://{parts.netloc}/bus", origin=origin, max_size=None))
        self.send(k="hello", protocol=1, token=parts.fragment)
        self.me = self.take("snapshot")["me"]

    def send(self, **frame: Any) -> None:
        self.socket.send(msgpack.packb(frame))

    def take(self, kind: str) -> dict[str, Any]:
        while True:
            found: dict[str, Any] = msgpack.unpackb(self.socket.recv(10.0), strict_map_key=False)
            if found["k"] == kind:
                return found

    def here(self) -> None:
        """Say that it is there, and read what has come: a page that reads nothing is closed."""
        self.send(k="here")
        with suppress(TimeoutError):
            while True:
                self.socket.recv(0)

    def ask(self, **frame: Any) -> dict[str, Any]:
        self.send(id="asked", **frame)
        return self.take("answer")


def attacks(number: int, me: str) -> list[dict[str, Any]]:
    """Return what the page of a pupil may not ask, under the number of somebody else's lease."""
    command = {"k": "command", "parameters": {}, "lease": number}
    return [
        {**command, "command": "set", "target": "afm_node"},
        {**command, "command": "arm", "target": "haptic_node"},
        {"k": "lease", "action": "take", "lease": number},
        {"k": "lease", "action": "hand_over", "to": me, "lease": number},
    ]


def counted(rig: Rig) -> dict[str, int]:
    """Return what the newest report of the page says that it has refused, by reason."""
    reports = [each.fields() for each in rig.recording().messages("node/health") if each.src == "viz_node@master"]
    return dict(reports[-1]["rejected"]) if reports else {}


def turns(rig: Rig) -> int:
    """Return how many states the hand has said in the last seconds that are recorded."""
    states = rig.recording().messages("haptic/state")
    return sum(each.publish_ns > states[-1].publish_ns - 0.8e9 * ATTACK_S for each in states)


def watched(rig: Rig, *pages: Client) -> int:
    """Return the same for a time without an attack."""
    end_s = time.monotonic() + ATTACK_S
    while time.monotonic() < end_s:
        for page in pages:
            page.here()
        time.sleep(0.1)
    return turns(rig)


def test_a_pupil_that_attacks_is_refused_and_the_loop_is_not_disturbed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(rig.sockets))
    rig.start("--duration", "300", *machine.LOWER_RATE, scenario="touch")
    rig.wait_until(rig.running, "a running session")
    with closing(View(rig.environment)) as view, ExitStack() as stack:

        def given(name: str, role: str) -> str:
            done = rig.telenano("view", "--for", name, "--role", role)
            assert done.returncode == 0, done.stderr
            return f"{view.operator.partition('#')[0]}#{done.stdout.strip().rpartition('#')[2]}"

        teacher, address = Client(stack, given("Tina", "teacher")), given("Paul", "pupil")
        pupil = Client(stack, address)
        shares, told = [], 0
        for _ in range(ATTEMPTS):
            number = teacher.ask(k="lease", action="take")["lease"]["number"]
            before = watched(rig, teacher, pupil)
            end_s, refused = time.monotonic() + ATTACK_S, []
            while time.monotonic() < end_s:
                teacher.here()
                pupil.send(k="hand", force_n=5.0, held=True, lease=number)
                refused += [pupil.ask(**attack)["ok"] is False for attack in attacks(number, pupil.me)]
                time.sleep(0.1)
            assert all(refused) and len(refused) > 20
            told += len(refused)
            shares.append(turns(rig) / before)
            held = LeaseRegister().look().holder
            # A machine that holds the test up for a second loses the hand, and slows the loop down by itself.
            if held is not None and held.name == "Tina" and shares[-1] > 0.9:
                break
            machine.note(f"attacked again, because the machine held the rig up: {shares}, the hand is that of {held}")
        else:
            pytest.skip("the machine held the test up again and again")
        # an old number, by one who has the hand again
        again = teacher.ask(k="lease", action="let_go", lease=number), teacher.ask(k="lease", action="take")
        assert all(each["ok"] for each in again) and again[1]["lease"]["number"] > number
        replayed = teacher.ask(k="command", command="mark", target="recorder", parameters={}, lease=number)
        assert replayed["ok"], "a mark moves nothing and needs no lease"
        replayed = teacher.ask(k="command", command="stop", target="haptic_node", parameters={}, lease=number)
        assert replayed["ok"], "a stop asks for none either"
        replayed = teacher.ask(k="command", command="arm", target="haptic_node", parameters={}, lease=number)
        assert not replayed["ok"] and "an earlier lease" in replayed["text"]
        # each was counted, and so was each push of the pupil's hand
        pushed = told // len(attacks(number, pupil.me))
        rig.wait_until(lambda: counted(rig).get("lease", 0) >= told + pushed + 1, "the refusals in the page's report")
        gone = rig.telenano("view", "--revoke", "Paul")
        assert gone.returncode == 0, gone.stderr
        with pytest.raises(ConnectionClosed):
            while True:
                pupil.ask(k="lease", action="ask")
        with pytest.raises(ConnectionClosed):
            Client(stack, address)
        rig.wait_until(lambda: counted(rig).get("revoked", 0) == 2, "the page and the address that were refused")
        forces = [each.fields() for each in rig.recording().messages("operator/force")]
        assert not any(each.get("by") == "Paul" for each in forces)
        controls = [each.fields() for each in rig.recording().messages("session/control")]
        assert not any(each.get("by") == "Paul" for each in controls)
    code, _, err = rig.stop()
    assert code in (0, 1, 3), err
    assert "Traceback" not in err

"""Addresses of people by name, and pages that want more than their role has: refused, counted, nothing disturbed."""

import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import pytest

pytest.importorskip("starlette")
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from test_viz_server import ACCESS, Page, Rig, command
from typer.testing import CliRunner

from services.viz_node import age_report, command_desk, server
from services.viz_node import command as view_command
from services.viz_node import hub as hubs
from services.viz_node.feed import SeenMessage
from services.viz_node.metrics import metrics_text
from telenano.cli.root import app
from telenano.console.lease import CONSOLE, Party, take
from telenano.serving.access import Role
from telenano.serving.people import People
from telenano.testing import until
from telenano.timing.loop_age import Part
from telenano.wire.errors import ConfigError

ADDRESSES = [
    "view: http://127.0.0.1:8650/#secret",
    "observer: http://127.0.0.1:8650/#other",
    "participant: http://127.0.0.1:8650/participant.html#third",
]
PAUL, TINA, OTTO = "Paul", "Ms Tina Ås", "Otto"


@pytest.fixture
def people(tmp_path: Path) -> People:
    return People(tmp_path)


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.setattr(command_desk, "VALIDITY_S", 60.0)
    monkeypatch.setattr(hubs, "HAND_FRESH_S", 60.0)
    return Rig()


@pytest.fixture
def client(rig: Rig, people: People) -> Iterator[TestClient]:
    access = replace(ACCESS, people=people)
    with TestClient(server.make_app(rig.hub, access, None), client=("127.0.0.1", 5)) as found:
        yield found


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


class Named(Page):
    """A page of a person; it says that it is there as often as it asks."""

    def __init__(self, stack: ExitStack, client: TestClient, token: str) -> None:
        super().__init__(stack, client, token)
        self.snapshot = self.take("snapshot")

    def lease(self, action: str, number: int = 0, to: str = "") -> dict[str, Any]:
        return self.ask(k="lease", action=action, lease=number, to=to)

    def told(self, holder: str) -> dict[str, Any]:
        """Return the lease that the page is told of as soon as somebody has it."""
        while True:
            frame: dict[str, Any] = msgpack.unpackb(self.socket.receive_bytes())
            if "lease" in frame and frame["lease"]["label"] == holder:
                return dict(frame["lease"])


def test_an_address_has_a_name_a_role_and_an_end_and_is_revoked_at_once(people: People, tmp_path: Path) -> None:
    now_s = 1000.0
    people = People(tmp_path, lambda: now_s)
    access = replace(ACCESS, people=people)
    paul, tina = people.add(PAUL, "observer", 30.0), people.add(TINA, "operator", 90.0)
    assert (access.role_of(paul), access.role_of(tina)) == (Role.OBSERVER, Role.OPERATOR)
    assert paul not in (tmp_path / "people.json").read_text()
    assert (tmp_path / "people.json").stat().st_mode & 0o077 == 0
    now_s += 31.0 * 60.0
    assert (access.role_of(paul), access.role_of(tina)) == (None, Role.OPERATOR)
    # a second server of the same rig reads what changed
    other = People(tmp_path, lambda: now_s)
    other.revoke(TINA)
    person = access.person_of(tina)
    assert access.role_of(tina) is None and person is not None and not people.is_admitted(person)
    with pytest.raises(ConfigError, match="has no address; addresses exist for no person"):
        people.revoke(TINA)
    # a new address of the same name ends the old one
    first, second = people.add(OTTO, "operator", 1.0), people.add(OTTO, "operator", 1.0)
    assert (access.role_of(first), access.role_of(second)) == (None, Role.OPERATOR)


@pytest.mark.parametrize(
    ("name", "role", "minutes", "reason"),
    [
        ("", "operator", 1.0, "1 to 48"),
        ("x" * 49, "operator", 1.0, "1 to 48"),
        ("\x1b[2J", "operator", 1.0, "printable"),
        (" x", "operator", 1.0, "printable"),
        ("x", "king", 1.0, "must be one of observer, operator"),
        ("x", "operator", 0.0, "above 0"),
        ("x", "operator", float("inf"), "above 0"),
        ("x", "operator", float("nan"), "above 0"),
    ],
)
def test_what_is_no_name_role_or_time_is_refused(
    people: People, name: str, role: str, minutes: float, reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        people.add(name, role, minutes)


def test_a_file_that_others_can_read_or_that_is_none_admits_nobody(people: People, tmp_path: Path) -> None:
    token, file = people.add(PAUL, "operator", 30.0), tmp_path / "people.json"
    file.chmod(0o644)
    os.utime(file, (1, 1))
    assert people.find(token) is None
    file.chmod(0o600)
    os.utime(file, (2, 2))
    assert people.find(token) is not None
    file.write_text("[{]")
    assert people.find(token) is None


def test_a_page_that_sends_what_its_holder_may_is_refused_and_counted_and_the_loop_is_not_disturbed(
    rig: Rig, client: TestClient, stack: ExitStack, people: People
) -> None:
    holder = Named(stack, client, people.add(TINA, "operator", 30.0))
    other = Named(stack, client, people.add(PAUL, "operator", 30.0))
    assert holder.lease("take")["ok"] is True
    number = holder.told(TINA)["number"]
    # the page was changed by its person: it sends the number that is the other's
    for request in (command(lease=number), command(command="arm"), command(command="couple")):
        assert other.ask(**request)["text"] == f"{TINA} holds control: ask for it"
    other.send({"k": "hand", "force_n": 5.0, "held": True, "lease": number})
    assert other.take("hand")["text"] == f"{TINA} holds control: ask for it"
    for action in ("take", "hand_over"):
        assert other.lease(action, number, other.snapshot["me"])["ok"] is False
    assert (rig.hand, rig.commander.sent) == ([], [])
    assert rig.hub.desk.refused.rejected == {"lease": 6}
    assert PAUL in rig.hub.desk.refused.last_error
    # who only looks, and who is nobody
    observer = Named(stack, client, people.add(OTTO, "observer", 30.0))
    observer.send({"k": "hand", "force_n": 5.0, "held": True, "lease": number})
    assert observer.take("hand")["text"] == "this page cannot hold the hand"
    assert observer.lease("ask")["ok"] is False
    assert "the token is wrong" in Page(stack, client, "made-up-token").take("refused")["text"]
    assert rig.hub.desk.refused.rejected == {"lease": 6, "role": 2, "token": 1}
    # what anybody may
    assert other.ask(**command(command="mark", target="recorder"))["ok"] is True
    assert other.ask(k="estop")["ok"] is True


def taken_at_a_terminal(rig: Rig) -> None:
    rig.hub.desk._register.change(lambda lease, now_ns: take(lease, Party("c", what=CONSOLE), now_ns, from_anyone=True))


def test_the_hand_goes_from_one_to_the_other_and_what_was_held_is_let_go(
    rig: Rig, client: TestClient, stack: ExitStack, people: People
) -> None:
    tina = Named(stack, client, people.add(TINA, "operator", 30.0))
    paul = Named(stack, client, people.add(PAUL, "operator", 30.0))
    taken = tina.lease("take")
    assert taken["text"] == f"lease: {TINA} holds control"
    # a command that is given before any tick has told of the lease
    number = taken["lease"]["number"]
    assert tina.ask(**command(lease=number))["ok"] is True
    rig.commander.sent.clear()
    assert paul.lease("ask")["ok"] is True
    assert tina.lease("hand_over", number, paul.snapshot["me"])["text"] == f"lease: {PAUL} holds control"
    number = paul.told(PAUL)["number"]
    paul.send({"k": "hand", "force_n": 1.0, "held": True, "lease": number})
    until(lambda: 1.0 in rig.hand)
    taken_at_a_terminal(rig)
    assert paul.take("hand")["text"] == "Let go: the console at the rig holds control now"
    until(lambda: rig.hand[-1] == 0.0)
    # the same force, sent once more
    paul.send({"k": "hand", "force_n": 1.0, "held": True, "lease": number})
    assert paul.take("hand")["held"] is False
    assert rig.hand[-1] == 0.0
    # a hand that was taken is no hand that was lost
    assert rig.commander.sent == []


def test_a_command_that_is_being_sent_ends_when_the_hand_is_taken(
    rig: Rig, client: TestClient, stack: ExitStack, people: People
) -> None:
    otto = Named(stack, client, people.add(OTTO, "operator", 30.0))
    rig.commander.held.clear()
    otto.send({"id": "long", **command(command="couple")})
    until(lambda: rig.commander.begun)
    taken_at_a_terminal(rig)
    assert otto.take("answer")["ok"] is False
    assert rig.commander.sent == []


def test_a_revoked_address_is_closed_at_once_told_so_and_counted(
    rig: Rig, client: TestClient, stack: ExitStack, people: People
) -> None:
    token = people.add(OTTO, "operator", 30.0)
    otto = Named(stack, client, token)
    otto.send({"k": "hand", "force_n": 1.0, "held": True})
    until(lambda: 1.0 in rig.hand)
    people.revoke(OTTO)
    assert otto.take("refused")["text"] == hubs.REVOKED
    with pytest.raises(WebSocketDisconnect):
        otto.take("answer")
    until(lambda: rig.hand[-1] == 0.0)
    # it pressed, and the tip is withdrawn as that of a hand that is lost
    until(lambda: [each[:2] for each in rig.commander.sent] == [("stop", "afm_node@slave")])
    assert rig.commander.sent[0][2]["because"] == f"{OTTO} was closed while it pressed: the tip is withdrawn"
    again = Page(stack, client, token)
    assert again.take("refused")["text"] == hubs.REVOKED
    assert rig.hub.desk.refused.rejected == {"revoked": 2}


def test_commands_and_forces_say_who_gave_them(
    rig: Rig, client: TestClient, stack: ExitStack, people: People, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    send = rig.commander.send
    monkeypatch.setattr(rig.commander, "send", lambda *given: said.append(given[-1]) or send(*given))
    monkeypatch.setattr(rig.commander, "estop", lambda by: said.append(by) or {})
    otto = Named(stack, client, people.add(OTTO, "operator", 30.0))
    otto.ask(**command())
    otto.ask(k="estop")
    Page(stack, client).ask(**command())
    assert said == [OTTO, OTTO, ""]


def test_the_command_gives_an_address_at_each_page_of_the_rig(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    run = CliRunner().invoke
    alone = run(app, ["view", "--for", PAUL, "--role", "operator"])
    assert alone.exit_code == 2 and "no page of this rig is served" in alone.output
    monkeypatch.setattr(view_command, "served_addresses", lambda folders: ADDRESSES)
    given = run(app, ["view", "--for", PAUL, "--role", "operator", "--for-minutes", "30"])
    head, _, token = given.output.strip().partition("#")
    assert head == f"{PAUL} (operator, 30 min): http://127.0.0.1:8650/"
    assert replace(ACCESS, people=People()).role_of(token) is Role.OPERATOR
    assert run(app, ["view", "--revoke", PAUL]).output == f"the address of {PAUL} is revoked\n"
    assert replace(ACCESS, people=People()).role_of(token) is None
    assert run(app, ["view", "--revoke", PAUL]).exit_code == 2


def test_the_way_to_a_page_and_the_age_of_the_loop_are_told_and_given_to_a_monitoring_system(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(age_report, "_AGE_S", 0.05)
    page = Page(stack, client)
    t_ns = 10**18
    delay = {"direction": "forward", "hand_t_ns": t_ns, "delay_ns": 20_000_000, "transit_ns": 0, "clock_ahead_ns": 0}
    rig.source.waiting.append(SeenMessage("link/delay", "delay_node@master", t_ns, delay))
    for number in range(40):
        hand_ns = t_ns + number * 1_000_000
        afm = {"hand_t_ns": hand_ns}
        answer = {"answered_t_ns": hand_ns, "answered_at_ns": hand_ns + 23_000_000}
        age = rig.hub.age.loop_age
        age.take("afm/state", "afm_node@slave", hand_ns + 21_000_000, afm)
        age.take("haptic/command", "controller@master", hand_ns + 22_000_000, afm)
        age.take("haptic/state", "haptic_node@master", hand_ns + 24_000_000, answer)
    told: dict[str, float] = {}
    while not told:
        told = {name: p50_s for name, p50_s, _ in page.take("tick").get("age", ())}
    assert told["link there, on purpose"] == pytest.approx(0.02, rel=1e-9)
    assert told["whole"] == pytest.approx(0.023, rel=1e-9)
    text = metrics_text({}, 0, [Part("whole", 0.02, 0.023)])
    assert 'telenano_loop_age_seconds{part="whole",quantile="0.99"} 0.023' in text.splitlines()
    assert "# TYPE telenano_loop_age_seconds summary" in client.get("/metrics").text
    # the page had the question for a tenth of a second, which is not of the way
    for _ in range(3):
        stamp_s = page.take("way")["stamp_s"]
        page.send({"k": "here", "stamp_s": stamp_s, "waited_s": 0.0})
    until(lambda: any(session.ways_s for session in rig.hub.sessions))
    while (way_s := page.take("way")["way_s"]) is None:
        pass
    assert 0.0 <= way_s < 5.0

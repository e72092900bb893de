"""What a participant's page is sent: its traffic has nothing of the condition, and the picture is late.

Every message that pages are told of carries the condition in words and numbers here, wherever it has room for them,
but for what a participant sees and feels: where hand and tip are, and the forces on them.
"""

import random
import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("httpx2")
import bus_page
from bus_page import BusPage
from made_source import MadeSource
from starlette.testclient import TestClient
from telenano_lab.experiments import panel as panels
from telenano_lab.experiments.messages import CUE, Question
from telenano_lab.experiments.participant import CUE_KEYS, TRIAL_KEYS, ParticipantPicture

from services.viz_node import command_desk, server
from services.viz_node import hub as hubs
from services.viz_node.feed import SeenMessage
from services.viz_node.hub import Hub
from services.viz_node.requests import COMMANDS
from services.viz_node.source import TOPICS_SHOWN
from services.viz_node.streams import described
from telenano.serving.access import Access
from telenano.testing.filled_messages import examples
from telenano.wire import TOPICS, Array, Message
from telenano.wire.codec import fields_of

TOKEN = "participant-token-01"
ACCESS = replace(bus_page.ACCESS, participant_token=TOKEN)
# The condition: a law, a profile and a level in words, and a delay in numbers.
WORDS = ("model_mediated", "leo_satellite", "very_late", "condition")
DELAY_S = 0.12345
PICTURE_S = 0.28675
SEEN = ("position_m", "operator_force_n", "force_n", "base_position_m", "deflection_m", "tip_force_n", "separation_m")


class Commander:
    def send(self, *_: Any) -> dict[str, tuple[str, str]]:
        raise AssertionError("a participant commands nothing")

    def estop(self, by: str) -> dict[str, tuple[str, str]]:
        return {"afm_node@slave": ("ack", "latched under model_mediated")}


class Outlet:
    def __init__(self, rig: "Rig") -> None:
        self._rig = rig

    def push(self, force_n: float, across_n: tuple[float, float], by: str) -> None:
        self._rig.pushed.append(force_n)

    def publish(self, topic: str, **fields: Any) -> None:
        assert topic == "experiment/answer"
        self._rig.answers.append(fields)
        if self._rig.takes:
            self._rig.cue(answered=(fields["id"],))

    def now_ns(self) -> int:
        return 1_000

    def close(self) -> None:
        pass


class Rig:
    def __init__(self) -> None:
        self.source, self.seq = MadeSource("/rigs/leo_satellite.yaml"), 0
        self.pushed, self.answers, self.takes = [], [], True
        self.hub = Hub(self.source, Commander(), lambda: {"laws": list(WORDS)}, lambda: Outlet(self))

    def tell(self, topic: str, fields: Mapping[str, Any], src: str) -> None:
        self.seq += 1
        said = {**fields, "seq": self.seq, "t_ns": self.seq * 1_000_000, "src": src, "v": 1}
        self.source.waiting.append(SeenMessage(topic, src, said["t_ns"], said))

    def cue(self, **changes: Any) -> None:
        empty = fields_of(Array.from_numpy(np.empty(0)))
        fields = dict.fromkeys(CUE_KEYS) | {
            "id": "c-1",
            "stage": "trial",
            "title": "Touch",
            "text": "Press.",
            "done": 2,
        }
        fields |= {"total": 6, "practice": False, "quantity": "none", "band": 0.0, "times_s": empty, "target": empty}
        question = Question(name="felt", text="?", low="", high="", least=0.0, most=0.0, step=0.0, options=("now",))
        self.tell("experiment/cue", fields | {"questions": [fields_of(question)], "answered": ()} | changes, "c@master")

    def trial(self, picture_s: float = 0.0) -> None:
        fields = dict.fromkeys(TRIAL_KEYS, 0) | {"condition": {"law": WORDS[0], "level": WORDS[2], "delay": DELAY_S}}
        self.tell("experiment/trial", fields | {"text": WORDS[3], "picture_delay_s": picture_s}, "c@master")

    def tip(self, force_n: float, site: str = "slave") -> None:
        fields = told(examples(TOPICS["afm/state"])["ordinary"]) | {"tip_force_n": (0.0, 0.0, force_n)}
        self.tell("afm/state", fields, f"afm_node@{site}")


def told(message: Message) -> dict[str, Any]:
    """Return a message as plain data."""
    return fields_of(message)


def marked(value: Any, name: str = "") -> Any:
    """Return a part of a message with the condition in every text and number but those that are seen and felt."""
    if name in SEEN:
        return value
    if isinstance(value, Mapping):
        found = {key: marked(each, key) for key, each in value.items()}
        return found | ({WORDS[3]: DELAY_S} if name == "data" else {})
    if isinstance(value, str):
        return " ".join(WORDS)
    if isinstance(value, float):
        return DELAY_S
    return [marked(each) for each in value] if isinstance(value, list | tuple) else value


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Rig:
    monkeypatch.setattr(command_desk, "VALIDITY_S", 60.0)
    return Rig()


@pytest.fixture
def client(rig: Rig) -> Iterator[TestClient]:
    with TestClient(server.make_app(rig.hub, ACCESS, None), client=("127.0.0.1", 5)) as found:
        yield found


class Page(BusPage):
    def __init__(self, stack: ExitStack, client: TestClient, token: str = TOKEN) -> None:
        super().__init__(stack, client, token)

    def assert_blind(self) -> None:
        """Look for the condition in the bytes: words, and numbers in every form in which they are sent."""
        for word in WORDS:
            assert word.encode() not in self.traffic
        for number in (DELAY_S, PICTURE_S, 1e3 * DELAY_S, 1e3 * PICTURE_S):
            for form in ("<f", ">f", "<d", ">d"):
                assert struct.pack(form, number) not in self.traffic
            assert f"{number:.4g}".encode() not in self.traffic


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def given(cue: str = "c-1", values: Mapping[str, Any] | None = None, shown_s: float = 0.0) -> dict[str, Any]:
    """Return what a page sends to answer a cue."""
    answers = {f"answer.{name}": value for name, value in (values or {"felt": "now"}).items()}
    return {"k": "panel", "panel": "experiment", "values": {**answers, "cue": cue, "shown_s": shown_s}}


def stage(name: str) -> Any:
    return lambda frame: frame.get("state", {}).get("experiment/cue", {}).get("stage") == name


def test_nothing_of_the_condition_is_in_the_traffic(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    page, operator = Page(stack, client), Page(stack, client, ACCESS.operator_token)
    page.take("snapshot")
    rig.trial(PICTURE_S)
    for topic in sorted({*TOPICS_SHOWN} - {"afm/scanline"}):
        for case in ("ordinary", "nil"):
            for src in ("controller@master", "controller@slave"):
                fields = marked(told(examples(TOPICS[topic])[case]))
                rig.tell(topic, fields, src)
    rig.cue()
    page.take_where(stage("trial"))
    # what it asks for and may not have, and what it says: the answers are in words of their own
    refused = page.ask(k="command", command="set", target="controller", parameters={"law": "wave"})
    assert (refused["ok"], refused["text"]) == (False, "not carried out: tell the experimenter")
    for asked in ({"k": "document"}, {"k": "part", "from_s": 0.0, "to_s": 1.0, "spans": 0}):
        assert page.ask(**asked)["ok"] is False
    assert page.ask(k="estop")["ok"] is True
    assert page.ask(**given(values={"felt": "now"}, shown_s=1.5))["ok"] is True
    rig.cue(stage="end")
    page.take_where(stage("end"))
    page.assert_blind()
    # a page that comes later begins with a snapshot
    later = Page(stack, client)
    later.take("snapshot")
    later.assert_blind()
    # the search finds what is there: the operator's page is told of all that
    operator.take_where(stage("end"))
    for word in WORDS[:3]:
        assert word.encode() in operator.traffic


def test_only_columns_on_the_list_pass(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    page = Page(stack, client)
    snapshot = page.take("snapshot")
    names = {stream["name"]: [column["name"] for column in stream["columns"]] for stream in snapshot["streams"]}
    assert set(names) == {"hand", "command", "tip"}
    assert "loop_age" not in names["hand"]
    assert (snapshot["role"], snapshot["commands"], snapshot["nodes"], snapshot["events"]) == (
        "participant",
        False,
        {},
        [],
    )
    rig.tip(3e-9)
    frame = page.take_where(lambda frame: "tip" in frame.get("streams", {}))
    rows = np.frombuffer(frame["streams"]["tip"]["data"], "<f4").reshape(-1, frame["streams"]["tip"]["n"])
    assert len(rows) == len(names["tip"]) + 1
    assert rows[names["tip"].index("force") + 1, 0] == np.float32(3e-9)


def test_the_hand_is_held_and_answers_are_the_participants(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    page, experimenter = Page(stack, client), Page(stack, client, ACCESS.operator_token)
    page.send({"k": "hand", "force_n": 1.25, "held": True})
    rig.cue()
    page.take_where(stage("trial"))
    assert 1.25 in rig.pushed
    assert page.ask(**given(values={"felt": "now"}, shown_s=2.0))["ok"]
    assert experimenter.ask(**given(values={"action": "pause", "reason": ""}))["ok"]
    kept = [{key: answer[key] for key in ("role", "values", "shown_s", "given_ns")} for answer in rig.answers]
    assert {"role": "participant", "values": {"felt": "now"}, "shown_s": 2.0, "given_ns": 1_000} in kept
    assert [answer["role"] for answer in kept] == ["participant", "experimenter"]


def test_an_answer_is_sent_until_it_is_taken(rig: Rig, client: TestClient, stack: ExitStack) -> None:
    page, rig.takes = Page(stack, client), False
    rig.cue()
    page.take_where(stage("trial"))
    page.send({"id": "a-7", **given(values={"felt": "now"})})
    end = time.monotonic() + 10.0
    while len(rig.answers) < 3 and time.monotonic() < end:
        time.sleep(0.01)
    assert {answer["id"] for answer in rig.answers} == {"a-7"}
    rig.cue(answered=("a-7",))
    assert page.take("answer")["ok"] is True


def test_a_participant_has_one_answer_under_way_to_the_cue_that_stands(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is refused is said to nobody but the test, because a participant's answers are in words of their own.
    said: list[bool] = []
    monkeypatch.setattr(ParticipantPicture, "acknowledgement", lambda self, *, is_ok: said.append(is_ok) or "said")
    page, rig.takes = Page(stack, client), False
    assert not page.ask(**given())["ok"]
    rig.cue()
    page.take_where(stage("trial"))
    assert not page.ask(**given("c-0"))["ok"]
    assert not page.ask(**given(values={f"n{n}": "x" * 250 for n in range(17)}))["ok"]
    assert rig.answers == []
    for number in range(100):
        page.send({"id": f"b-{number}", **given()})
    refused = [page.take("answer") for _ in range(99)]
    assert not any(frame["ok"] for frame in refused)
    assert {answer["id"] for answer in rig.answers} == {"b-0"}
    # An answer is not sent any longer once the cue has gone, and the page may answer the next one.
    rig.cue(id="c-2")
    assert page.take("answer")["ok"] is False
    rig.takes = True
    assert page.ask(**given("c-2"))["ok"] is True


def test_who_answers_no_experiment_is_told_so(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(panels, "_ANSWER_DEADLINE_S", 0.05)
    rig.takes = False
    operator, observer = (Page(stack, client, token) for token in (ACCESS.operator_token, ACCESS.observer_token))
    assert (
        operator.ask(**given(values={"action": "skip"}))["text"]
        == "no experiment received the answer: check that one is running"
    )
    assert "token of an observer" in observer.ask(**given(values={"action": "skip"}))["text"]


def streams(at: float) -> dict[str, Any]:
    """Return a sample of all streams at a time."""
    made = {}
    for stream in described():
        rows = np.full((len(stream["columns"]) + 1, 1), at, "<f4")
        rows[0] = 0.0
        made[stream["name"]] = {"n": 1, "t0": at, "data": rows.tobytes()}
    return {"streams": made}


def state_of(delay_s: float) -> dict[str, Any]:
    return {"state": {"experiment/trial": {"picture_delay_s": delay_s}}}


@pytest.mark.parametrize("delay_s", [0.0, 0.1, 0.4])
def test_the_picture_is_late_and_the_hand_is_not(delay_s: float) -> None:
    picture, period_s = ParticipantPicture(described()), 1.0 / 30.0
    picture.take(state_of(delay_s), 0.0)
    late: list[float] = []
    for n in range(1, 60):
        now_s = n * period_s
        shown = [
            (name, found) for each in picture.take(streams(now_s), now_s) for name, found in each["streams"].items()
        ]
        assert [found["t0"] for name, found in shown if name in ("hand", "command")] == pytest.approx([now_s] * 2)
        for name, found in shown:
            if name == "tip":
                sampled_s = float(np.frombuffer(found["data"], "<f4")[1])
                late.append(now_s - sampled_s)
                # its time is that at which it is shown, or the two streams would tell the delay
                assert found["t0"] == pytest.approx(now_s, abs=1e-5)
    assert late
    assert min(late) >= delay_s - 1e-5
    assert max(late) <= delay_s + period_s + 1e-5


def test_a_shorter_delay_shows_what_was_held_and_in_order() -> None:
    picture = ParticipantPicture(described())
    picture.take(state_of(1.0), 0.0)
    for n in range(1, 4):
        assert not [each for each in picture.take(streams(0.1 * n), 0.1 * n) if "tip" in each["streams"]]
    shown = [each["streams"]["tip"] for each in picture.take(state_of(0.0), 0.4) if "tip" in each.get("streams", {})]
    assert [float(np.frombuffer(found["data"], "<f4")[1]) for found in shown] == pytest.approx([0.1, 0.2, 0.3])


def test_a_participant_has_a_token_of_its_own() -> None:
    from telenano.serving.access import Role
    from telenano.wire import ConfigError

    access = Access.made(participant="q" * 20)
    assert access.role_of("q" * 20) is Role.PARTICIPANT
    assert access.role_of("") is None
    assert Access("o" * 20, "p" * 20).role_of("") is None
    with pytest.raises(ConfigError, match="are the same"):
        Access.made(operator="q" * 20, participant="q" * 20)


def test_a_page_is_told_all_of_a_cue_but_its_header() -> None:
    header = {"seq", "t_ns", "src", "v", "run"}
    assert set(CUE_KEYS) == set(CUE.model.__struct_fields__) - header


def test_nothing_that_the_page_of_a_participant_asks_commands_the_rig_or_tells_the_condition(
    rig: Rig, client: TestClient, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    commanded: list[Any] = []
    monkeypatch.setattr(Commander, "send", lambda self, *given: commanded.append(given) or {})
    monkeypatch.setattr(Commander, "estop", lambda self, by: {"afm_node@slave": ("ack", " ".join(WORDS))})
    # another limit keeps a page from asking more often than a person could
    monkeypatch.setattr(hubs.Session, "may_ask", lambda self, now_s: True)
    draw = random.Random(72)
    page = Page(stack, client)
    rig.trial(PICTURE_S)
    rig.cue()
    page.take_where(stage("trial"))
    numbers = (0, 1, rig.hub.desk.lease.number, 2**53)
    texts = ("", "*", "afm_node", "c-1", "c-0", "x" * 256, "\x1b[2J", "play", "../..")
    values: tuple[Any, ...] = ({}, {"felt": "now"}, {"law": "wave"}, {f"n{n}": n for n in range(60)})
    reals = (0.0, -1.0, 1e308, 5e-324)

    def drawn() -> dict[str, Any]:
        kinds: tuple[dict[str, Any], ...] = (
            {"k": "command", "command": draw.choice(COMMANDS), "target": draw.choice(texts),
             "parameters": draw.choice(values), "lease": draw.choice(numbers)},
            {"k": "lease", "action": draw.choice(("ask", "take", "hand_over", "let_go")), "to": draw.choice(texts),
             "lease": draw.choice(numbers)},
            {"k": "transport", "action": draw.choice(texts), "value": draw.choice(reals)},
            {"k": "document"},
            {"k": "part", "from_s": draw.choice(reals), "to_s": draw.choice(reals), "spans": draw.choice((0, 2**60))},
            {"k": "estop"},
            {"k": "panel", "panel": draw.choice(("experiment", "experiment", "particles", "")),
             "values": {**draw.choice(values), "cue": draw.choice(texts), "shown_s": draw.choice((0.0, "now"))}},
        )  # fmt: skip
        return draw.choice(kinds)

    for _ in range(150):
        asked = drawn()
        is_ok = page.ask(**asked)["ok"]
        is_own = asked["k"] == "panel" and asked["panel"] == "experiment" and asked["values"]["cue"] == "c-1"
        assert is_ok == (asked["k"] == "estop") or is_own, asked
        page.send({"k": "here", "stamp_s": draw.choice(reals), "waited_s": draw.choice(reals)})
    assert commanded == []
    assert rig.hub.desk.lease.holder is None and rig.hub.desk.lease.asking == ()
    page.assert_blind()
    assert rig.hub.desk.refused.rejected["role"] > 20


def test_a_delay_beyond_what_is_held_is_shortened_to_it() -> None:
    picture = ParticipantPicture(described())
    picture.take(state_of(1e9), 0.0)
    assert picture.delay_s < 10.0

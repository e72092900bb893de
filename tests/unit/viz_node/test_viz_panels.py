"""Panels of packages at the server of the page: what it serves, what it tells pages, and what it hands to a desk."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import pytest

pytest.importorskip("starlette")
pytest.importorskip("httpx2")
from made_source import MadeSource
from starlette.testclient import TestClient
from test_viz_server import ACCESS as PAGES
from test_viz_server import Page

from services.viz_node import feed, hub, server, source
from services.viz_node.feed import SeenMessage
from services.viz_node.hub import Hub
from telenano.serving import Asked, Panel
from telenano.serving import panels as panels_module
from telenano.serving.panels import Panels, installed_panels
from telenano.serving.serve import addresses_of
from telenano.settings.plugins import LoadedEntries
from telenano.wire import DurationS, Message, RefusedError, Topic, about
from telenano.wire.topics import register_topic

ACCESS = replace(PAGES, participant_token="guest-token-000001")


class WindSpeed(Message):
    """The draught at the instrument."""

    gust_s: Annotated[DurationS, about("How long a gust lasts [s]")]


class Desk:
    """Publishes what it is asked, and refuses the rest."""

    async def ask(self, asked: Asked) -> str:
        if "gust_s" not in asked.values:
            raise RefusedError("give gust_s")
        asked.rig.publish("wind/speed", gust_s=asked.values["gust_s"])
        return f"{asked.role} was told {asked.rig.state('wind/speed').get('gust_s')}"


class Blind:
    """Tells guests nothing but that they are there."""

    def __init__(self, streams: Any) -> None:
        self.streams = streams

    def take(self, changes: Any, now_s: float) -> list[dict[str, Any]]:
        return []

    def snapshot(self, snapshot: Any, *, hand: bool) -> dict[str, Any]:
        return {"k": "snapshot", "role": "participant"}

    def acknowledgement(self, *, is_ok: bool) -> str:
        return "yes" if is_ok else "no"


class Outlet:
    def __init__(self, sent: list[Any]) -> None:
        self.sent = sent

    def push(self, *_: Any) -> None:
        pass

    def publish(self, topic: str, **fields: Any) -> None:
        self.sent.append((topic, fields))

    def now_ns(self) -> int:
        return 1

    def close(self) -> None:
        pass


@pytest.fixture
def panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Panel:
    folder = tmp_path / "wind" / "web"
    (folder / "icons").mkdir(parents=True)
    for name in ("wind.js", "wind.css", "icons/a.svg", "guest.html", "secret.py", "key"):
        (folder / name).write_text(name)
    (tmp_path / "wind" / "wind.js").write_text("outside")
    shown = {"wind/speed": ("gust_s",)}
    found = Panel("wind", "Wind", "watch", folder / "wind.js", shown, "wind/speed", Desk, "guest.html", Blind)
    panels = Panels((found,), ("rain of the package rain 1.2 cannot be used: no licence",))
    for module in (hub, feed, source):
        monkeypatch.setattr(module, "installed_panels", lambda: panels)
    monkeypatch.setattr("telenano.serving.serve.installed_panels", lambda: panels)
    register_topic(Topic("wind/speed", WindSpeed, ("view",), "lossless", None, None, None))
    return found


@pytest.fixture
def rig(panel: Panel) -> tuple[Hub, MadeSource, list[Any]]:
    sent: list[Any] = []
    where = MadeSource()
    return Hub(where, open_hand=lambda: Outlet(sent)), where, sent


@pytest.fixture
def client(rig: tuple[Hub, MadeSource, list[Any]]) -> Iterator[TestClient]:
    with TestClient(server.make_app(rig[0], ACCESS, None), client=("127.0.0.1", 5)) as found:
        yield found


def test_only_files_of_a_page_in_the_folder_of_the_module_are_served(client: TestClient) -> None:
    for name in ("wind.js", "wind.css", "icons/a.svg", "guest.html"):
        answer = client.get(f"/panels/wind/{name}")
        assert (answer.status_code, answer.text) == (200, name)
        assert "default-src 'none'" in answer.headers["content-security-policy"]
        assert answer.headers["x-content-type-options"] == "nosniff"
    assert client.get("/panels/wind/wind.js").headers["content-type"].startswith("text/javascript")
    outside = ("secret.py", "key", "../wind.js", "%2e%2e/wind.js", "..%2fwind.js", "icons/../secret.py", "", "icons")
    for name in outside:
        answer = client.get(f"/panels/wind/{name}")
        assert answer.status_code == 404 and "secret" not in answer.text and "outside" not in answer.text, name
    for path in ("/panels/", "/panels/rain/wind.js", "/panels//etc/passwd", "/panels/wind"):
        assert client.get(path).status_code == 404, path
    assert client.get("/panels/wind/wind.js", headers={"host": "evil.example"}).status_code == 403


def asked(page: Page, **values: Any) -> tuple[bool, str]:
    answer = page.ask(k="panel", panel="wind", values=values)
    return answer["ok"], answer["text"]


def test_pages_are_told_of_panels_and_of_their_topics_and_guests_of_neither(
    rig: tuple[Hub, MadeSource, list[Any]], client: TestClient
) -> None:
    with ExitStack() as stack:
        operator, guest = (Page(stack, client, token) for token in (ACCESS.operator_token, ACCESS.participant_token))
        told = operator.take("snapshot")
        row = {"id": "wind", "title": "Wind", "region": "watch", "shows": "wind/speed"}
        assert told["panels"] == [row | {"url": "./panels/wind/wind.js"}]
        assert told["problems"] == ["rain of the package rain 1.2 cannot be used: no licence"]
        assert guest.take("snapshot") == {"k": "snapshot", "role": "participant"}
        fields = {"seq": 0, "t_ns": 1, "src": "view@master", "v": 1, "gust_s": 2.5}
        rig[1].waiting.append(SeenMessage("wind/speed", "view@master", 1, fields))
        while "state" not in (tick := operator.take("tick")):
            pass
        assert tick["state"] == {"wind/speed": {"gust_s": 2.5}}


def test_a_desk_carries_out_what_its_page_asks_and_no_observer_asks(
    rig: tuple[Hub, MadeSource, list[Any]], client: TestClient
) -> None:
    with ExitStack() as stack:
        tokens = (ACCESS.operator_token, ACCESS.participant_token, ACCESS.observer_token)
        operator, guest, observer = (Page(stack, client, token) for token in tokens)
        assert asked(operator, gust_s=1.5) == (True, "wind: operator was told None")
        assert asked(operator, other=1) == (False, "give gust_s")
        assert asked(guest, gust_s=2.5) == (True, "yes")
        assert asked(observer, gust_s=3.5)[0] is False
        assert rig[2] == [("wind/speed", {"gust_s": 1.5}), ("wind/speed", {"gust_s": 2.5})]
        assert operator.ask(k="panel", panel="rain", values={})["text"] == "'rain': no panel of this name can be asked"
        assert asked(operator, **{f"n{n}": "x" * 256 for n in range(20)})[0] is False


def test_guests_have_an_address_where_a_package_has_a_page_for_them(
    panel: Panel, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Bound:
        def getsockname(self) -> tuple[str, int]:
            return "127.0.0.1", 8650

    found = addresses_of(Bound(), ACCESS, None)  # type: ignore[arg-type]
    assert found["participant"] == f"http://127.0.0.1:8650/panels/wind/guest.html#{ACCESS.participant_token}"
    monkeypatch.setattr("telenano.serving.serve.installed_panels", Panels)
    assert set(addresses_of(Bound(), ACCESS, None)) == {"operator", "observer"}  # type: ignore[arg-type]


def test_without_a_page_for_guests_their_token_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (hub, feed, source):
        monkeypatch.setattr(module, "installed_panels", Panels)
    with (
        TestClient(server.make_app(Hub(MadeSource()), ACCESS, None), client=("127.0.0.1", 5)) as client,
        ExitStack() as stack,
    ):
        assert (
            "no installed package has a page" in Page(stack, client, ACCESS.participant_token).take("refused")["text"]
        )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"id": "gale"}, "its id is 'gale', must be the name of its entry, wind"),
        ({"region": "status"}, "region 'status': must be one of stage, controls, dock, watch"),
        ({"module": Path("/nowhere/wind.js")}, "must be a file of JavaScript"),
        ({"module": Path(__file__)}, "must be a file of JavaScript"),
        ({"topics": {"wind": ()}}, "topics: 'wind' is not the name of a topic"),
        ({"guest_page": "none.html"}, "guest_page: none.html is not a file beside"),
        ({"guest_picture": None}, "guest_page: guest.html has no guest_picture"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_row_that_cannot_be_used_is_refused_in_a_sentence(panel: Panel, change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        panels_module._checked("wind", panel._replace(**change))
    with pytest.raises(TypeError, match="is a str, must be a Panel of"):
        panels_module._checked("wind", "wind.js")


def test_a_panel_that_cannot_be_used_leaves_the_others(panel: Panel, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = LoadedEntries({"wind": panel}, {"rain": "rain of the package rain 1.2 cannot be used: no licence"})
    monkeypatch.setattr(panels_module, "load", lambda kind, check: loaded)
    installed_panels.cache_clear()
    try:
        assert installed_panels().rows == (panel,)
        assert installed_panels().problems == tuple(loaded.problems.values())
        assert installed_panels().topics == {"wind/speed": ("gust_s",)}
    finally:
        installed_panels.cache_clear()

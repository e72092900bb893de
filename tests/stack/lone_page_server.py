"""The server of the page without a rig: what a page sends with its hand is given to a function."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import doubles_path  # noqa: F401
import uvicorn
from made_source import MadeSource

from services.viz_node import server
from services.viz_node.command_desk import Commander
from services.viz_node.feed import SeenMessage
from services.viz_node.hub import Hub
from telenano.serving.access import Access

# Takes the force down [N] and across [N, N].
Push = Callable[[float, tuple[float, float]], None]


class _Source(MadeSource):
    def __init__(self, news: Callable[[], list[SeenMessage]]) -> None:
        super().__init__()
        self._news = news

    def poll(self, *, watched: bool) -> list[SeenMessage]:
        return self._news()


class _Device:
    def __init__(self, push: Push) -> None:
        self._push = push

    def push(self, force_n: float, across_n: tuple[float, float], by: str) -> None:
        self._push(force_n, across_n)

    def answer(self, **fields: Any) -> None:
        pass

    def now_ns(self) -> int:
        return time.time_ns()

    def close(self) -> None:
        pass


class _Commander:
    def send(self, *given: Any) -> dict[str, tuple[str, str]]:
        return {}

    def estop(self, by: str) -> dict[str, tuple[str, str]]:
        return {}


class LonePageServer:
    """Serves a page at an address until `end`; `hub` is what the page speaks to, `news` what the rig would say."""

    def __init__(
        self,
        push: Push,
        access: Access,
        *,
        host: str,
        port: int,
        page: Path | None = None,
        news: Callable[[], list[SeenMessage]] = list,
        commander: Commander | None = None,
        forms: Callable[[], Mapping[str, Any]] | None = None,
    ) -> None:
        self.hub = Hub(_Source(news), commander or _Commander(), forms, open_hand=lambda: _Device(push))
        app = server.make_app(self.hub, access, page)
        self._server = uvicorn.Server(uvicorn.Config(app, host=host, port=port, log_level="warning"))

    def run(self) -> None:
        self._server.run()

    @property
    def listens(self) -> bool:
        """Return whether a page can be opened."""
        return self._server.started

    def end(self) -> None:
        self._server.should_exit = True

"""Panels that packages add to the page: each is an entry point of `telenano.panels`, a row that names an ES module.

    PANEL = Panel("wind", "Wind", "watch", Path(__file__).with_name("wind.js"), {"wind/speed": ("speed_m_per_s",)})

The module exports `make(root, api)`, which fills an element and returns the callbacks of the page
(docs/extending/io.md). It is served from its folder, together with the other web files there.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, get_args

from telenano.settings.plugins import load
from telenano.wire.messages import Scalar
from telenano.wire.topics import NAME

Region = Literal["stage", "controls", "dock", "watch"]
# Only these kinds of files are served from a panel's folder, so that no Python code is.
_SUFFIXES = (".css", ".html", ".js", ".json", ".mjs", ".png", ".svg", ".woff2")
_ID = re.compile(r"[a-z][a-z0-9_]{0,31}")


class Asked(NamedTuple):
    """Request of a page to the half of its panel that runs in the server.

    Args:
        id: The identifier of the request; a repetition has the same one.
        page: The identifier of the page, the same for all its requests.
        role: The role of the page: `participant` for a guest page, else the role of its person.
        values: The values of the request, by name.
        rig: The rig that the page shows, for publishing and reading.
    """

    id: str
    page: str
    role: str
    values: Mapping[str, Scalar]
    rig: "PanelRig"


class PanelRig(Protocol):
    """Interface by which the desk of a panel (its part on the server) reads and commands the rig of its page."""

    def publish(self, topic: str, **fields: Any) -> object:
        """Publish on a topic, as `view@master`."""

    def now_ns(self) -> int:
        """Return the time on the clock of the rig [ns]."""

    def state(self, topic: str) -> Mapping[str, Any]:
        """Return the state of a panel's topic last sent to pages; empty before the first message."""


class Desk(Protocol):
    """The half of a panel that runs in the server and carries out the requests of pages, concurrently with the rest."""

    async def ask(self, asked: Asked) -> str:
        """Carry out a request and return the answer; raise RefusedError with the reason if it is refused."""


class Picture(Protocol):
    """Filter that reduces the messages for all pages to those for guest pages."""

    def take(self, changes: Mapping[str, Any], now_s: float) -> list[dict[str, Any]]:
        """Return the changes to send to guests at a time [s], each in a frame of its own."""

    def snapshot(self, snapshot: Mapping[str, Any], *, hand: bool) -> dict[str, Any]:
        """Return the initial state for a guest page, from that for an operator's page."""

    def acknowledgement(self, *, is_ok: bool) -> str:
        """Return the answer to a request in words that reveal nothing else."""


class Panel(NamedTuple):
    """A panel of a package.

    Args:
        id: The name of the entry point and of the panel's element.
        title: The heading.
        region: The region of the page.
        module: The file of the ES module.
        topics: The topics whose newest message is sent to pages, each with the keys to send.
        shows: The state without which the panel is hidden, such as one of these topics; empty to show it always.
        desk: Factory of the half in the server; None without one.
        guest_page: The HTML file, in the folder of the panel, for guests, who see less than others: they press, answer
            and stop, and command nothing. Only one installed panel may have it.
        guest_picture: Factory of the guests' `Picture`, from the streams of pages (name, topic and columns of each).
    """

    id: str
    title: str
    region: Region
    module: Path
    topics: Mapping[str, tuple[str, ...]] = {}
    shows: str = ""
    desk: Callable[[], Desk] | None = None
    guest_page: str = ""
    guest_picture: Callable[[Sequence[Mapping[str, Any]]], Picture] | None = None

    @property
    def base(self) -> str:
        """The URL path below which the files of the panel are served."""
        return f"panels/{self.id}/"

    def files(self) -> dict[str, Path]:
        """Return the served files, by their path below `base`."""
        folder = self.module.parent
        paths = sorted(path for path in folder.rglob("*") if path.suffix in _SUFFIXES and path.is_file())
        return {path.relative_to(folder).as_posix(): path for path in paths}

    def about(self) -> dict[str, Any]:
        """Return the description of the panel that is sent to a page."""
        url = f"./{self.base}{self.module.name}"
        return {"id": self.id, "title": self.title, "region": self.region, "shows": self.shows, "url": url}


class Panels(NamedTuple):
    """The panels of installed packages, and a sentence for each that cannot be used."""

    rows: tuple[Panel, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def topics(self) -> dict[str, tuple[str, ...]]:
        """The topics of all panels, each with the keys to send to pages."""
        wanted: dict[str, tuple[str, ...]] = {}
        for row in self.rows:
            for topic, keys in row.topics.items():
                wanted[topic] = tuple(dict.fromkeys((*wanted.get(topic, ()), *keys)))
        return wanted

    @property
    def of_guests(self) -> Panel | None:
        """The panel with a guest page; None without one."""
        return next((row for row in self.rows if row.guest_page), None)


@cache
def installed_panels() -> Panels:
    """Return the panels of installed packages; cached, because the server loads them at its start."""
    loaded = load("panels", _checked)
    return Panels(tuple(loaded.found.values()), tuple(loaded.problems.values()))


def _checked(name: str, panel: Any) -> Panel:
    """Return a valid panel; raise TypeError or ValueError, with the fault, for an invalid entry."""
    if not isinstance(panel, Panel):
        raise TypeError(f"is a {type(panel).__name__}, must be a Panel of telenano.serving")
    if not _ID.fullmatch(panel.id) or panel.id != name:
        raise ValueError(f"its id is {panel.id!r}, must be the name of its entry, {name}")
    if panel.region not in get_args(Region):
        raise ValueError(f"region {panel.region!r}: must be one of {', '.join(get_args(Region))}")
    if panel.module.suffix not in (".js", ".mjs") or not panel.module.is_file():
        raise ValueError(f"module {panel.module}: must be a file of JavaScript, NAME.js")
    if wrong := [topic for topic in panel.topics if not NAME.fullmatch(topic)]:
        raise ValueError(f"topics: {wrong[0]!r} is not the name of a topic, such as wind/speed")
    if panel.guest_page and (panel.guest_picture is None or not (panel.module.parent / panel.guest_page).is_file()):
        lack = "has no guest_picture" if panel.guest_picture is None else f"is not a file beside {panel.module}"
        raise ValueError(f"guest_page: {panel.guest_page} {lack}")
    return panel

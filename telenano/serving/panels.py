"""Panels of packages on the page, each an entry point of `telenano.panels`: an ES module, and a row that says of what.

    PANEL = Panel("wind", "Wind", "watch", Path(__file__).with_name("wind.js"), {"wind/speed": ("speed_m_per_s",)})

The module exports `make(root, api)`, which fills an element and returns what the page calls after that
(docs/extending/io.md). It is served from the folder in which it lies, together with the other files of a page there.
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
# Only these files of a panel's folder are served, so that no code of the package is.
_SUFFIXES = (".css", ".html", ".js", ".json", ".mjs", ".png", ".svg", ".woff2")
_ID = re.compile(r"[a-z][a-z0-9_]{0,31}")


class Asked(NamedTuple):
    """What a page asks of the half of its panel that runs in the server.

    Args:
        id: The identifier of the request; the same one where it is sent again.
        page: What the page is called, the same for all its requests.
        role: The role of the page: `participant` where it belongs to guests, else that of who may have the hand.
        values: What was asked, by name.
        rig: The rig that the page shows, for what is published and read there.
    """

    id: str
    page: str
    role: str
    values: Mapping[str, Scalar]
    rig: "PanelRig"


class PanelRig(Protocol):
    """What a desk has of the rig that its page shows."""

    def publish(self, topic: str, **fields: Any) -> object:
        """Publish on a topic, as `view@master`."""

    def now_ns(self) -> int:
        """Return the time on the clock of the rig [ns]."""

    def state(self, topic: str) -> Mapping[str, Any]:
        """Return what was sent to pages last of a topic of the panel; empty before the first message."""


class Desk(Protocol):
    """The half of a panel that runs in the server: it carries out what pages ask, beside everything else there."""

    async def ask(self, asked: Asked) -> str:
        """Carry out what was asked and return what to answer; RefusedError says why not."""


class Picture(Protocol):
    """Makes of what all pages are sent what guests are sent."""

    def take(self, changes: Mapping[str, Any], now_s: float) -> list[dict[str, Any]]:
        """Return the changes that guests are sent at a time [s], each for a frame of its own."""

    def snapshot(self, snapshot: Mapping[str, Any], *, hand: bool) -> dict[str, Any]:
        """Return what the page of a guest begins with, of what that of an operator begins with."""

    def acknowledgement(self, *, is_ok: bool) -> str:
        """Return the answer to a request in words that tell nothing else."""


class Panel(NamedTuple):
    """A panel of a package.

    Args:
        id: Its name, that of the entry and of its element.
        title: Its heading.
        region: The region of the page.
        module: The ES module, a file.
        topics: Of which topics pages are sent the newest message, and which of its keys.
        shows: The state without which the panel is not there, such as one of these topics; empty for always.
        desk: Makes the half in the server, where the panel has one.
        guest_page: The HTML file, in the folder of the panel, of people who are sent less than the others: they press,
            answer and stop, and command nothing. One installed panel may have it.
        guest_picture: Makes their picture, of the streams that pages have (name, topic and columns of each).
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
        """The path at which the files of the panel are served."""
        return f"panels/{self.id}/"

    def files(self) -> dict[str, Path]:
        """Return the files that are served, by their path below `base`."""
        folder = self.module.parent
        paths = sorted(path for path in folder.rglob("*") if path.suffix in _SUFFIXES and path.is_file())
        return {path.relative_to(folder).as_posix(): path for path in paths}

    def about(self) -> dict[str, Any]:
        """Return what a page is sent of it."""
        url = f"./{self.base}{self.module.name}"
        return {"id": self.id, "title": self.title, "region": self.region, "shows": self.shows, "url": url}


class Panels(NamedTuple):
    """The panels of installed packages, and a sentence for each that cannot be used."""

    rows: tuple[Panel, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def topics(self) -> dict[str, tuple[str, ...]]:
        """The topics of all panels, each with the keys that pages are sent."""
        wanted: dict[str, tuple[str, ...]] = {}
        for row in self.rows:
            for topic, keys in row.topics.items():
                wanted[topic] = tuple(dict.fromkeys((*wanted.get(topic, ()), *keys)))
        return wanted

    @property
    def of_guests(self) -> Panel | None:
        """The panel whose package has a page for guests, None without one."""
        return next((row for row in self.rows if row.guest_page), None)


@cache
def installed_panels() -> Panels:
    """Return the panels of installed packages, which the server of a page loads at its start."""
    loaded = load("panels", _checked)
    return Panels(tuple(loaded.found.values()), tuple(loaded.problems.values()))


def _checked(name: str, panel: Any) -> Panel:
    """Return an entry that is a panel; TypeError or ValueError says what is wrong with it."""
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
        lack = "has no guest_picture" if panel.guest_picture is None else f"is no file beside {panel.module}"
        raise ValueError(f"guest_page: {panel.guest_page} {lack}")
    return panel

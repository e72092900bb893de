"""The paths at which other processes reach this one: whether they are still there, and how they are made again.

A folder of sockets may be removed while a rig runs: by the system at the last logout, by what cleans up, or by a
person. Whoever is connected remains connected and notices nothing, but no command comes in any more, an emergency stop
least of all. So the loop of each node looks at its paths twice a second.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from telenano.wire.errors import TelenanoError

# A path that could not be made again at so many looks in a row is given up: half a second after it was missed first.
_LOOKS = 2


class Place(Protocol):
    """Something that stands at a path: a socket, or a lock."""

    def lost(self) -> str:
        """Return the path where another file or none stands there by now; empty while it is in place."""

    def make_again(self) -> None:
        """Put it there again; a TelenanoError says why that is not possible."""


class PlaceNotice(NamedTuple):
    """What has happened to paths, as a sentence."""

    level: str
    text: str
    path: str
    state: str


class Places:
    """The places of one process."""

    def __init__(self, prepare: Callable[[], None] = lambda: None) -> None:
        """Begin without a place; `prepare` is called before one is made again, and raises where that is not safe."""
        self._prepare = prepare
        self._places: list[Place] = []
        # Why a place cannot be made again, empty while each is in place; at how many looks in a row that was so.
        self.obstacle = ""
        self._failures = 0

    def add(self, place: Place) -> None:
        """Look after a further place."""
        self._places.append(place)

    @property
    def given_up(self) -> bool:
        """Whether a place is lost and could not be made again for as long as is waited."""
        return self._failures >= _LOOKS

    def are_kept(self) -> bool:
        """Return whether everything is in place."""
        return not any(place.lost() for place in self._places)

    def look(self) -> list[PlaceNotice]:
        """Make again what is gone, and return what there is to say of it."""
        lost = [(place, path) for place in self._places if (path := place.lost())]
        if not lost:
            self._failures, self.obstacle = 0, ""
            return []
        path = lost[0][1]
        what = f"{path} was removed or replaced while this process ran"
        try:
            self._prepare()
            for place, _ in lost:
                place.make_again()
        except TelenanoError as error:
            before, self.obstacle = self.obstacle, str(error)
            self._failures += 1
            if self.obstacle == before:
                return []
            text = f"{what} and cannot be made again ({error}): commands may not reach it"
            return [PlaceNotice("error", text, path, "lost")]
        self._failures, self.obstacle = 0, ""
        text = f"{what}; it was made again, and commands reach this process as before"
        return [PlaceNotice("warning", text, path, "made_again")]

"""The paths at which other processes reach this one: checked for existence, and made again when they are lost.

A folder of sockets may be removed while a rig runs: by the system at the last logout, by a clean-up program, or by a
person. Existing connections stay and notice nothing, but new ones fail, so that no command arrives any more, above all
no emergency stop. So the loop of each node checks its paths twice a second.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from telenano.wire.errors import TelenanoError

# A path that could not be made again at this number of checks in a row is given up: half a second after the first.
_LOOKS = 2


class Place(Protocol):
    """A file that belongs at a path: a socket, or a lock."""

    def lost(self) -> str:
        """Return the path if its file was removed or replaced; empty while the file is in place."""

    def make_again(self) -> None:
        """Make the file again; raise a TelenanoError with the reason if that is not possible."""


class PlaceNotice(NamedTuple):
    """A report on a path: its level, a sentence, the path, and the state `lost` or `made_again`."""

    level: str
    text: str
    path: str
    state: str


class Places:
    """The places of one process."""

    def __init__(self, prepare: Callable[[], None] = lambda: None) -> None:
        """Begin without places; `prepare` is called before a place is made again, and raises if that is not safe."""
        self._prepare = prepare
        self._places: list[Place] = []
        # Reason why a place cannot be made again, empty while all are in place; number of failed checks in a row.
        self.obstacle = ""
        self._failures = 0

    def add(self, place: Place) -> None:
        """Add a place to check."""
        self._places.append(place)

    @property
    def given_up(self) -> bool:
        """Whether a place is lost and could not be made again at two checks in a row."""
        return self._failures >= _LOOKS

    @property
    def is_hopeless(self) -> bool:
        """Whether as many more checks have failed, during which each device that has lost its place has stopped."""
        return self._failures >= 2 * _LOOKS

    def are_kept(self) -> bool:
        """Return whether all places are intact."""
        return not any(place.lost() for place in self._places)

    def look(self) -> list[PlaceNotice]:
        """Check all places, make lost ones again, and return the notices; a repeated failure is reported once."""
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

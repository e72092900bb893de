"""People with a personal address of the page: role, expiry and revocation of each.

They are listed in a file of the rig's private folder, which `telenano view --for NAME` writes and every page server
rereads when it changes. It contains digests of the tokens instead of the tokens.
"""

import hashlib
import secrets
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from telenano.console.lease import MOST_LETTERS
from telenano.files.atomic_files import changed
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.runtime.security.private_files import check_runtime_directory, read_secret
from telenano.wire.errors import ConfigError
from telenano.wire.printable import printable

ROLES = ("observer", "operator")
_MOST_PEOPLE = 1000
_MOST_MINUTES = 60 * 24 * 366
_TOKEN_BYTES = 24
_FILE = "people.json"


def known_role(role: str) -> str:
    """Return the name of a role unchanged; raise ConfigError, with a list of roles, if it is unknown."""
    if role not in ROLES:
        raise ConfigError(f"--role {role}: must be one of {', '.join(ROLES)}")
    return role


class Person(msgspec.Struct, frozen=True):
    """A person with an address of their own; `digest`: that of the token; `until_s`: Unix time of expiry [s]."""

    name: str
    role: str
    digest: str
    until_s: float
    revoked: bool = False

    def is_admitted(self, now_s: float) -> bool:
        """Return whether the address is valid at a Unix time [s]."""
        return not self.revoked and now_s < self.until_s


class People:
    """The people of a rig."""

    def __init__(self, folder: Path | None = None, now_s: Callable[[], float] = time.time) -> None:
        """Use the file in a folder; None for the runtime folder of the rig. `now_s` returns the Unix time [s]."""
        self._folder, self._now_s = folder, now_s
        self._read: tuple[int, int] | None = None
        self._people: dict[str, Person] = {}

    def add(self, name: str, role: str, minutes: float) -> str:
        """Create an address for a person and revoke an earlier one of that name; return its token.

        Raises:
            ConfigError: The name, the role or the time is invalid.
        """
        if not 0 < len(name) <= MOST_LETTERS or not name.isprintable() or name.strip() != name:
            raise ConfigError(f"--for {printable(name)[:80]!r}: a name has 1 to {MOST_LETTERS} printable letters")
        known_role(role)
        if not 0.0 < minutes <= _MOST_MINUTES:
            raise ConfigError(f"--for-minutes {minutes:g}: must be above 0, and a year at most")
        token, now_s = secrets.token_urlsafe(_TOKEN_BYTES), self._now_s()

        def with_person(people: list[Person]) -> list[Person]:
            # Keep expired people for a day, so that their pages can say so.
            kept = [each for each in people if each.name != name and now_s < each.until_s + 86400.0]
            kept += [msgspec.structs.replace(each, revoked=True) for each in people if each.name == name]
            return [*kept, Person(name, role, _digest(token), now_s + 60.0 * minutes)][-_MOST_PEOPLE:]

        self._change(with_person)
        return token

    def revoke(self, name: str) -> None:
        """Revoke the address of a person; raise ConfigError if no person of that name has a valid one."""

        def without_person(people: list[Person]) -> list[Person]:
            names = sorted({each.name for each in people if each.is_admitted(self._now_s())})
            if name not in names:
                raise ConfigError(
                    f"--revoke {printable(name)}: has no address; addresses exist for {', '.join(names) or 'no person'}"
                )
            return [msgspec.structs.replace(each, revoked=each.revoked or each.name == name) for each in people]

        self._change(without_person)

    def find(self, token: str) -> Person | None:
        """Return the person of a token, even if it is no longer valid; None for an unknown one."""
        self._all()
        return self._people.get(_digest(token))

    def is_admitted(self, person: Person) -> bool:
        """Return whether a person is still admitted according to the present file."""
        self._all()
        person_admitted = self._people.get(person.digest)
        return person_admitted is not None and person_admitted.is_admitted(self._now_s())

    @property
    def _path(self) -> Path:
        return (self._folder or runtime_directory()) / _FILE

    def _all(self) -> list[Person]:
        """Return the people in the file, reading it if it has changed; an unreadable file admits no one."""
        try:
            status = self._path.stat()
            mark = status.st_mtime_ns, status.st_ino
            if mark != self._read:
                listed = msgspec.json.decode(read_secret(self._path), type=list[Person])
                self._people, self._read = {each.digest: each for each in listed}, mark
        except (OSError, ConfigError, msgspec.MsgspecError):
            self._people, self._read = {}, None
        return list(self._people.values())

    def _change(self, step: Callable[[list[Person]], list[Person]]) -> None:
        """Change the file by a step from its present entries; a damaged file counts as empty and is replaced."""

        def changed_bytes(before: bytes | None) -> bytes:
            try:
                people = msgspec.json.decode(before or b"[]", type=list[Person])
            except msgspec.MsgspecError:
                people = []
            return msgspec.json.encode(step(people))

        if self._folder is None:
            check_runtime_directory(make=True)
        changed(self._path, changed_bytes, read=read_secret)


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()

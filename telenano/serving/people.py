"""People who were given an address of the page by name: what each may do, until when, and whether it was revoked.

They are in a file of the private folder of the rig, which `telenano view --for NAME` writes and every server of a page
reads again when it has changed. It has digests of the tokens and not the tokens.
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

ROLES = ("observer", "pupil", "operator", "teacher")
_MOST_PEOPLE = 1000
_MOST_MINUTES = 60 * 24 * 366
_TOKEN_BYTES = 24
_FILE = "people.json"


def known_role(role: str) -> str:
    """Return the name of a role as it is; ConfigError with the roles that there are, if it is none."""
    if role not in ROLES:
        raise ConfigError(f"--role {role}: must be one of {', '.join(ROLES)}")
    return role


class Person(msgspec.Struct, frozen=True):
    """Somebody with an address of their own. `until_s`: the Unix time at which it ends [s]."""

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
        """Read them in a folder, without one in that of the rig."""
        self._folder, self._now_s = folder, now_s
        self._read: tuple[int, int] | None = None
        self._people: dict[str, Person] = {}

    def add(self, name: str, role: str, minutes: float) -> str:
        """Give somebody an address, in the place of an earlier one of that name; return its token.

        Raises:
            ConfigError: The name, the role or the time is not one.
        """
        if not 0 < len(name) <= MOST_LETTERS or not name.isprintable() or name.strip() != name:
            raise ConfigError(f"--for {printable(name)[:80]!r}: a name has 1 to {MOST_LETTERS} printable letters")
        known_role(role)
        if not 0.0 < minutes <= _MOST_MINUTES:
            raise ConfigError(f"--for-minutes {minutes:g}: must be above 0, and a year at most")
        token, now_s = secrets.token_urlsafe(_TOKEN_BYTES), self._now_s()

        def with_person(people: list[Person]) -> list[Person]:
            # Who is no longer admitted is kept for a day, to be told so.
            kept = [each for each in people if each.name != name and now_s < each.until_s + 86400.0]
            kept += [msgspec.structs.replace(each, revoked=True) for each in people if each.name == name]
            return [*kept, Person(name, role, _digest(token), now_s + 60.0 * minutes)][-_MOST_PEOPLE:]

        self._change(with_person)
        return token

    def revoke(self, name: str) -> None:
        """Revoke the address of somebody; ConfigError where no person of that name has one."""

        def without_person(people: list[Person]) -> list[Person]:
            names = sorted({each.name for each in people if each.is_admitted(self._now_s())})
            if name not in names:
                raise ConfigError(
                    f"--revoke {printable(name)}: has no address; addresses exist for {', '.join(names) or 'no person'}"
                )
            return [msgspec.structs.replace(each, revoked=each.revoked or each.name == name) for each in people]

        self._change(without_person)

    def find(self, token: str) -> Person | None:
        """Return whose token it is, also one that is no longer valid; None for an unknown one."""
        self._all()
        return self._people.get(_digest(token))

    def is_admitted(self, person: Person) -> bool:
        """Return whether somebody is still admitted, as the file is now."""
        self._all()
        person_admitted = self._people.get(person.digest)
        return person_admitted is not None and person_admitted.is_admitted(self._now_s())

    @property
    def _path(self) -> Path:
        return (self._folder or runtime_directory()) / _FILE

    def _all(self) -> list[Person]:
        """Return the people of the file, which is read when it has changed; one that cannot be read admits none."""
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
        """Change the file, whose newest entries the step gets; one that is damaged admits none, and is replaced."""

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

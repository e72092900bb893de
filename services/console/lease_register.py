"""The lease of a rig on this machine: a file in the private folder of the rig, which its pages and consoles share."""

import contextlib
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from proto.errors import RefusedError, RigError
from services.console.lease import BEAT_S, CONSOLE, Lease, Party, act, current, let_go, packed, seen, take, unpacked
from services.runtime.bus.local_endpoint import runtime_directory
from services.runtime.security.private_files import check_runtime_directory
from services.runtime.settings.optional_modules import optional_module

fcntl = optional_module("fcntl")

NAME_VARIABLE = "TELENANO_NAME"
_FILE = "lease"
# A change takes microseconds: whoever has the file for longer stands still.
_PATIENCE_S, _RETRY_S = 1.0, 0.005

Step = Callable[[Lease, int], Lease]


class LeaseRegister:
    """Reads and changes the lease, one process at a time; what a process that is killed leaves of it is nobody's."""

    def __init__(self, folder: Path | None = None) -> None:
        """Keep the lease in a folder, without one in that of the rig."""
        self._folder = folder

    def look(self) -> Lease:
        """Return the lease as it is now; that somebody has vanished is kept, because it counts."""
        try:
            found = unpacked(self._path.read_bytes())
        except OSError:
            return Lease()
        return found if current(found, time.monotonic_ns()) == found else self.change(current)

    def change(self, step: Step) -> Lease:
        """Change the lease by a step, which gets the time as well, and return it.

        Raises:
            RefusedError: The step refuses.
            RigError: The file cannot be had.
        """
        try:
            check_runtime_directory(make=self._folder is None)
            lock = os.open(f"{self._path}.lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise RigError(f"{self._path}: who has the hand cannot be kept: {error.strerror}") from error
        try:
            self._lock(lock)
            before = unpacked(self._path.read_bytes()) if self._path.exists() else Lease()
            lease = step(before, time.monotonic_ns())
            if lease != before:
                # Who reads meanwhile finds the whole of one or of the other.
                new = self._path.with_name(f".{_FILE}.new")
                new.write_bytes(packed(lease))
                new.replace(self._path)
            return lease
        finally:
            os.close(lock)

    @property
    def _path(self) -> Path:
        return (self._folder or runtime_directory()) / _FILE

    def _lock(self, descriptor: int) -> None:
        end_s = time.monotonic() + _PATIENCE_S
        while fcntl is not None:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except OSError as error:
                if time.monotonic() > end_s:
                    raise RigError(f"{self._path}: a process that stands still has it: end it") from error
                time.sleep(_RETRY_S)


class Hold:
    """A process that has the hand, and says every quarter of a second that it is there."""

    def __init__(self, party: Party, register: LeaseRegister, step: Step) -> None:
        self.party, self._register = party, register
        self.lost = False
        self._holds = register.change(step).is_held_by(party)
        self._over = threading.Event()
        if self._holds:
            threading.Thread(target=self._beat, name="lease", daemon=True).start()

    def is_held(self) -> bool:
        """Return whether nobody has taken the hand meanwhile."""
        if self._holds:
            self.lost |= not self._register.look().is_held_by(self.party)
        return not self.lost

    def end(self) -> None:
        """Let go of the hand."""
        self._over.set()
        if self._holds:
            with contextlib.suppress(RigError):
                self._register.change(lambda lease, now_ns: let_go(lease, self.party, now_ns))

    def _beat(self) -> None:
        while not self._over.wait(BEAT_S):
            with contextlib.suppress(RigError):
                self._register.change(lambda lease, now_ns: seen(lease, self.party, now_ns))


# What this process has taken the hand for, if it has.
_held: list[Hold] = []


def this_process(what: str = CONSOLE, *, role: str = "operator") -> Party:
    """Return this process as a party, under the name that TELENANO_NAME gives it."""
    return Party(secrets.token_hex(8), os.environ.get(NAME_VARIABLE, ""), role, what)


@contextlib.contextmanager
def holding(what: str, *, role: str = "operator", register: LeaseRegister | None = None) -> Iterator[Hold]:
    """Have the hand for a program, an experiment or a command of a teacher while the block runs.

    Raises:
        RefusedError: A page has it; the sentence names whose.
    """
    if _held:
        yield _held[-1]
        return
    party = this_process(what, role=role)
    hold = Hold(party, register or LeaseRegister(), lambda lease, now_ns: take(lease, party, now_ns))
    _held.append(hold)
    try:
        yield hold
    finally:
        _held.remove(hold)
        hold.end()


@contextlib.contextmanager
def acting() -> Iterator[Hold]:
    """Have the hand for one command of this process, unless it has taken it for longer.

    Raises:
        RefusedError: Another has it.
    """
    if _held:
        if not _held[-1].is_held():
            holder = LeaseRegister().look().holder
            raise RefusedError(f"{holder.label if holder else 'nobody'} has the hand now: this process lost it")
        yield _held[-1]
        return
    party = this_process()
    hold = Hold(party, LeaseRegister(), lambda lease, now_ns: act(lease, party, now_ns))
    try:
        yield hold
    finally:
        hold.end()

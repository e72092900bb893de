"""Storage of a rig's lease in a file of its private folder, which its pages and consoles on this machine share."""

import contextlib
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from telenano.console.lease import BEAT_S, CONSOLE, Lease, Party, act, current, heard, let_go, packed, take, unpacked
from telenano.files.atomic_files import changed
from telenano.files.regular_files import open_regular, read_regular
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.runtime.security.private_files import check_runtime_directory
from telenano.wire.errors import ConfigError, RefusedError, RigError

NAME_VARIABLE = "TELENANO_NAME"
_FILE = "lease"
# Most bytes that are read; a lease is far smaller.
_MOST_BYTES = 65_536

Step = Callable[[Lease, int], Lease]


class LeaseRegister:
    """Reads and changes the lease, one process at a time; a killed process leaves no lock."""

    def __init__(self, folder: Path | None = None) -> None:
        """Use the file in a folder; None for the runtime folder of the rig."""
        self._folder = folder
        self._unkept = Lease(), Lease()

    def look(self) -> Lease:
        """Return the lease as of now; if a holder has vanished, also write this to the file if possible."""
        try:
            lease = self._read()
        except OSError:
            return Lease()
        now = current(lease, time.monotonic_ns())
        if now == lease:
            return now
        with contextlib.suppress(RigError):
            return self.change(current)
        # If the file cannot be changed, return the same lease for the same content each time.
        if self._unkept[0] != lease:
            self._unkept = lease, now
        return self._unkept[1]

    def change(self, step: Step) -> Lease:
        """Change the lease by a step, a function of lease and monotonic time [ns], and return the new lease.

        Raises:
            RefusedError: The step refuses.
            RigError: The file cannot be changed.
        """
        try:
            check_runtime_directory(make=self._folder is None)
        except ConfigError as error:
            raise RigError(str(error)) from error
        lease = Lease()

        def changed_bytes(before: bytes | None) -> bytes | None:
            nonlocal lease
            known = Lease() if before is None else self._read()
            lease = step(known, time.monotonic_ns())
            is_only_seen = lease._replace(seen_ns=known.seen_ns) == known
            return None if lease == known or (is_only_seen and self._is_noted(lease.seen_ns)) else packed(lease)

        changed(self._path, changed_bytes, read=self._content, is_forced=False)
        return lease

    @property
    def _path(self) -> Path:
        return (self._folder or runtime_directory()) / _FILE

    @staticmethod
    def _content(path: Path) -> bytes:
        return read_regular(path, _MOST_BYTES, follows_links=False)

    def _read(self) -> Lease:
        """Return the lease in the file; the file's modification time, if later, is when its holder was last seen."""
        with open_regular(self._path, follows_links=False) as file:
            lease, seen_ns = unpacked(file.read(_MOST_BYTES)), os.fstat(file.fileno()).st_mtime_ns
        # A file that was just written has calendar time, which is far ahead of the monotonic clock and is ignored.
        return lease._replace(seen_ns=seen_ns) if lease.seen_ns < seen_ns <= time.monotonic_ns() else lease

    def _is_noted(self, seen_ns: int) -> bool:
        """Store the time at which the holder was seen [ns] as the file's time, which works even on a full disk.

        Returns False if the file system stores times in larger steps.
        """
        os.utime(self._path, ns=(seen_ns, seen_ns))
        return self._path.stat().st_mtime_ns == seen_ns


class Hold:
    """Control held by this process, which reports its presence every quarter of a second."""

    def __init__(self, party: Party, register: LeaseRegister, step: Step) -> None:
        self.party, self._register = party, register
        self.lost = False
        self._holds = register.change(step).is_held_by(party)
        self._over = threading.Event()
        if self._holds:
            threading.Thread(target=self._beat, name="lease", daemon=True).start()

    def is_held(self) -> bool:
        """Return whether control has not been lost meanwhile."""
        if self._holds:
            self.lost |= not self._register.look().is_held_by(self.party)
        return not self.lost

    def end(self) -> None:
        """Release control."""
        self._over.set()
        if self._holds:
            with contextlib.suppress(RigError):
                self._register.change(lambda lease, now_ns: let_go(lease, self.party, now_ns))

    def _beat(self) -> None:
        while not self._over.wait(BEAT_S):
            with contextlib.suppress(RigError):
                self._register.change(lambda lease, now_ns: heard(lease, {self.party.id: now_ns}, now_ns))


# The present hold of this process, if any.
_held: list[Hold] = []


def this_process(what: str = CONSOLE) -> Party:
    """Return this process as a party, under the name that TELENANO_NAME gives it."""
    return Party(secrets.token_hex(8), os.environ.get(NAME_VARIABLE, ""), what=what)


@contextlib.contextmanager
def holding(what: str, *, from_anyone: bool = False, register: LeaseRegister | None = None) -> Iterator[Hold]:
    """Hold control for a program, an experiment or a command while the block runs, even if another party holds it.

    Only with `from_anyone` is it taken from a party that is not the owner of the rig.

    Raises:
        RefusedError: Another party holds control; the sentence names it.
    """
    if _held:
        yield _held[-1]
        return
    party = this_process(what)
    step = partial(take, party=party, from_anyone=from_anyone)
    hold = Hold(party, register or LeaseRegister(), lambda lease, now_ns: step(lease, now_ns=now_ns))
    _held.append(hold)
    try:
        yield hold
    finally:
        _held.remove(hold)
        hold.end()


@contextlib.contextmanager
def acting() -> Iterator[Hold]:
    """Hold control for one command of this process, unless it already holds it for longer.

    Raises:
        RefusedError: Another process or page holds control, or this process has lost it.
    """
    if _held:
        if not _held[-1].is_held():
            holder = LeaseRegister().look().holder
            now = f"{holder.label} holds control now" if holder else "control is free now"
            raise RefusedError(f"{now}: this process lost it")
        yield _held[-1]
        return
    party = this_process()
    hold = Hold(party, LeaseRegister(), lambda lease, now_ns: act(lease, party, now_ns))
    try:
        yield hold
    finally:
        hold.end()

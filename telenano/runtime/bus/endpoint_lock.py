"""The lock of an ipc endpoint: without it, libzmq would silently take over the socket of a running process."""

import contextlib
import errno
import os
import stat
from io import FileIO
from pathlib import Path

from telenano.files.optional_modules import optional_module
from telenano.runtime.bus.holders import look
from telenano.wire.errors import EndpointError

# Windows has neither this module nor ipc endpoints; recordings and studies work without them.
fcntl = optional_module("fcntl")


class EndpointInUseError(EndpointError):
    """Another process holds an endpoint; `holder` is its process id, as text."""

    def __init__(self, text: str, holder: str) -> None:
        super().__init__(text)
        self.holder = holder


class EndpointLock:
    """Holds an ipc endpoint for this process until it is released; other endpoints need no lock.

    The kernel releases the lock when the last process with its descriptor ends: this one, or one that has inherited it.
    The file contains the process id, the node and the path, one per line, for `holders.look`.
    """

    def __init__(self, endpoint: str, node: str = "") -> None:
        """Lock the file beside the socket; raise EndpointInUseError, which names the process that holds it."""
        self._socket = Path(endpoint.removeprefix("ipc://")) if endpoint.startswith("ipc://") else None
        self._path = Path(f"{self._socket}.lock")
        self._endpoint, self._node = endpoint, node or self._path.name.removesuffix(".lock")
        if self._socket is not None:
            self._refuse_if_held(self._socket)
        # A file object closes itself, so that an interruption before this assignment leaves no descriptor open that
        # holds the lock.
        self._lock = None if self._socket is None else self._acquire()

    @property
    def descriptors(self) -> tuple[int, ...]:
        """The descriptors that a further process has to inherit to hold the endpoint as well."""
        return () if self._lock is None else (self._lock.fileno(),)

    def lost(self) -> str:
        """Return the path of the lock if its file was removed or replaced; empty while it is in place."""
        return "" if self._lock is None or self._is_current(self._lock) else str(self._path)

    def make_again(self) -> None:
        """Lock the file that is at the path now; raise EndpointError as the constructor does.

        The descriptor keeps its number, so that processes started later inherit the new lock.
        """
        if self._lock is not None:
            with self._acquire() as taken:
                os.dup2(taken.fileno(), self._lock.fileno(), inheritable=False)

    def release(self) -> None:
        """Remove socket and lock file, unless the lock file was removed or replaced, and release the lock."""
        if self._lock is None or self._socket is None:
            return
        # While the lock is in place, no other process has bound the endpoint; if it is not, both files may belong to
        # another process.
        for path in () if self.lost() else (self._socket, self._path):
            with contextlib.suppress(OSError):
                path.unlink()
        self._lock.close()
        self._lock = None

    def _refuse_if_held(self, path: Path) -> None:
        """Raise EndpointInUseError if another process holds the endpoint, even if its lock file was removed."""
        for holder in look().at(str(path)):
            if holder.process != os.getpid():
                raise self._in_use(holder.owner)

    def _in_use(self, holder: str) -> EndpointInUseError:
        text = f"{self._endpoint} is in use by process {holder}: stop it, or use another site file"
        return EndpointInUseError(text, holder)

    def _acquire(self) -> FileIO:
        if fcntl is None:
            raise EndpointError(f"{self._endpoint}: this system has no ipc endpoints; give tcp ones in the site file")
        while True:
            lock = self._open()
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                holder = (os.pread(lock.fileno(), 64, 0).decode(errors="replace").split() or ["unknown"])[0]
                lock.close()
                raise self._in_use(holder) from error
            if self._is_current(lock):
                lock.truncate(0)
                with contextlib.suppress(OSError):
                    # On a full disk the lock is held all the same; only its text is missing.
                    os.pwrite(lock.fileno(), f"{os.getpid()}\n{self._node}\n{self._socket}\n".encode(), 0)
                return lock
            # The previous holder removed the file after this process opened and before it locked it, so the lock is
            # useless.
            lock.close()

    def _open(self) -> FileIO:
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            try:
                lock = FileIO(os.open(self._path, flags, 0o644), "r+")
            except FileNotFoundError:
                # Another rig has just removed the folder, which belonged to a rig that has ended.
                self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                lock = FileIO(os.open(self._path, flags, 0o644), "r+")
            if not stat.S_ISREG(os.fstat(lock.fileno()).st_mode):
                lock.close()
                raise OSError(errno.EINVAL, "it is a pipe, socket or device, and must be a regular file")
            return lock
        except OSError as error:
            raise EndpointError(f"{self._endpoint}: {self._path} cannot be opened: {error.strerror}") from error

    def _is_current(self, lock: FileIO) -> bool:
        try:
            return os.path.samestat(os.fstat(lock.fileno()), self._path.stat())
        except OSError:
            return False

"""The lock of an ipc endpoint: libzmq itself would silently take the socket away from a running process."""

import contextlib
import errno
import os
import stat
from io import FileIO
from pathlib import Path

from telenano.files.optional_modules import optional_module
from telenano.runtime.bus.holders import look
from telenano.wire.errors import EndpointError

# Windows has neither this module nor ipc endpoints; recordings and studies need neither.
fcntl = optional_module("fcntl")


class EndpointInUseError(EndpointError):
    """Another process holds an endpoint; `holder` is its number, as text."""

    def __init__(self, text: str, holder: str) -> None:
        super().__init__(text)
        self.holder = holder


class EndpointLock:
    """Holds an ipc endpoint for this process until it is released; any other endpoint needs no lock.

    The kernel ends the lock with the last process that has its descriptor: this one, and those that inherit it. The
    file has the number of this process, the node and the path in a line each, for `holders.look`.
    """

    def __init__(self, endpoint: str, node: str = "") -> None:
        """Lock the file beside the socket; EndpointError names the process that holds it."""
        self._socket = Path(endpoint.removeprefix("ipc://")) if endpoint.startswith("ipc://") else None
        self._path = Path(f"{self._socket}.lock")
        self._endpoint, self._node = endpoint, node or self._path.name.removesuffix(".lock")
        if self._socket is not None:
            self._refuse_if_held(self._socket)
        # A file object, so that an interruption before it is kept leaves no descriptor open that holds the lock.
        self._lock = None if self._socket is None else self._acquire()

    @property
    def descriptors(self) -> tuple[int, ...]:
        """What a further process has to inherit to hold the endpoint as well."""
        return () if self._lock is None else (self._lock.fileno(),)

    def lost(self) -> str:
        """Return the path of the lock where another file or none stands there by now; empty while it is in place."""
        return "" if self._lock is None or self._is_current(self._lock) else str(self._path)

    def make_again(self) -> None:
        """Lock the file that stands at the path now; EndpointError as at first.

        The descriptor keeps its number, so that processes which are started later inherit the new lock.
        """
        if self._lock is not None:
            with self._acquire() as taken:
                os.dup2(taken.fileno(), self._lock.fileno(), inheritable=False)

    def release(self) -> None:
        """Remove socket and lock file, if they are still those of this lock, and let the endpoint go."""
        if self._lock is None or self._socket is None:
            return
        # While the lock is in place, no other process has bound the endpoint; afterwards both may be another's.
        for path in () if self.lost() else (self._socket, self._path):
            with contextlib.suppress(OSError):
                path.unlink()
        self._lock.close()
        self._lock = None

    def _refuse_if_held(self, path: Path) -> None:
        """Raise EndpointInUseError where another process holds the endpoint whose lock file somebody has removed."""
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
                    # On a full disk the lock holds all the same, and only its text is missing.
                    os.pwrite(lock.fileno(), f"{os.getpid()}\n{self._node}\n{self._socket}\n".encode(), 0)
                return lock
            # The holder removed the file between our opening and our locking it, so it locks nothing any more.
            lock.close()

    def _open(self) -> FileIO:
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            try:
                lock = FileIO(os.open(self._path, flags, 0o644), "r+")
            except FileNotFoundError:
                # Another rig has just removed the folder of one that had ended.
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

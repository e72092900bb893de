"""The lock of an ipc endpoint: libzmq itself would silently take the socket away from a running process."""

import contextlib
import errno
import os
import stat
from pathlib import Path
from typing import IO

from telenano.files.optional_modules import optional_module
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

    The kernel ends the lock with the last process that has its descriptor: this one, and those that inherit it.
    """

    def __init__(self, endpoint: str) -> None:
        """Lock the file beside the socket; EndpointError names the process that holds it."""
        self._socket = Path(endpoint.removeprefix("ipc://")) if endpoint.startswith("ipc://") else None
        self._path = Path(f"{self._socket}.lock")
        self._file = None if self._socket is None else self._acquire(endpoint)

    @property
    def descriptors(self) -> tuple[int, ...]:
        """What a further process has to inherit to hold the endpoint as well."""
        return () if self._file is None else (self._file.fileno(),)

    def release(self) -> None:
        """Remove socket and lock file, and let the endpoint go."""
        if self._file is None or self._socket is None:
            return
        # The lock guarantees that no other process has bound the endpoint.
        for path in (self._socket, self._path):
            with contextlib.suppress(OSError):
                path.unlink()
        self._file.close()
        self._file = None

    def _acquire(self, endpoint: str) -> IO[str]:
        if fcntl is None:
            raise EndpointError(f"{endpoint}: this system has no ipc endpoints; give tcp ones in the site file")
        while True:
            lock = self._open(endpoint)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                holder = lock.read().strip() or "unknown"
                lock.close()
                raise EndpointInUseError(
                    f"{endpoint} is in use by process {holder}: stop it, or use another site file", holder
                ) from error
            if self._is_current(lock):
                lock.truncate(0)
                lock.write(str(os.getpid()))
                lock.flush()
                return lock
            # The holder removed the file between our opening and our locking it, so it locks nothing any more.
            lock.close()

    def _open(self, endpoint: str) -> IO[str]:
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            try:
                descriptor = os.open(self._path, flags, 0o644)
            except FileNotFoundError:
                # Another rig has just removed the folder of one that had ended.
                self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                descriptor = os.open(self._path, flags, 0o644)
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                os.close(descriptor)
                raise OSError(errno.EINVAL, "it is a pipe, socket or device, and must be a regular file")
            return os.fdopen(descriptor, "r+")
        except OSError as error:
            raise EndpointError(f"{endpoint}: {self._path} cannot be opened: {error.strerror}") from error

    def _is_current(self, lock: IO[str]) -> bool:
        try:
            return os.path.samestat(os.fstat(lock.fileno()), self._path.stat())
        except FileNotFoundError:
            return False

"""The cache of compiled steps on disk: what is damaged or outdated is compiled again, and never run.

A file for each function and signature, whatever the edits: what is compiled after one takes the place of what was.
"""

import hashlib
import logging
import os
import pickle
import re
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from numba.core import config, types
from numba.core.caching import FunctionCache, IndexDataCacheFile

from presets.regular_files import is_own
from services.numerics.compiled import kept_digest

# Each file has a digest, because numba's own cache cannot notice that a file was cut off or changed.
_DIGEST_BYTES = hashlib.sha256().digest_size
# A file that is read is marked as used at this interval.
_USED_S = 86_400.0


class _DamagedError(Exception):
    """A file of the cache does not have the content that was written to it."""


class _Key(NamedTuple):
    """Which file a compiled function is in, and the digest of what it was compiled from, empty if it is not kept."""

    name: str
    digest: str


class CheckedCacheFile(IndexDataCacheFile):
    """The files of one function; numba's, but for their names, their checksums, and that there is no index."""

    @property
    def _folder(self) -> Path:
        """The folder of all functions; each package has one in it."""
        return Path(self._cache_path).parent

    def load(self, key: _Key) -> Any:
        """Return what was compiled, None where it is absent, outdated or damaged."""
        path = Path(self._data_path(key.name))
        if not key.digest:
            return None
        try:
            with path.open("rb") as file:
                found, content = os.fstat(file.fileno()), file.read()
            if not is_own(found):
                _warn(f"the compiled code in {self._folder} can be written by others, and is compiled again")
                return None
            if time.time() - found.st_mtime > _USED_S:
                os.utime(path)
            digest, version, compiled = _checked(content)
        except _DamagedError:
            _warn(f"the compiled code in {self._folder} was damaged, and is compiled again")
            return None
        except OSError:
            return None
        # The code is unpickled only here, because outdated code may name classes that no longer exist.
        return pickle.loads(compiled) if (digest, version) == (key.digest, self._version) else None

    def save(self, key: _Key, data: Any) -> None:
        """Keep what was compiled; where that is not possible it is compiled again the next time."""
        if not key.digest:
            return
        content = pickle.dumps((key.digest, self._version, self._dump(data)))
        try:
            with self._open_for_write(self._data_path(key.name)) as file:
                if hasattr(os, "fchmod"):
                    os.fchmod(file.fileno(), 0o600)
                file.write(hashlib.sha256(content).digest() + content)
        except OSError as error:
            _warn(f"compiled code cannot be kept in {self._folder}: {error.strerror}")


class CheckedCache(FunctionCache):
    """The cache of one function, in the form that Python can call or in that which only compiled code calls."""

    def __init__(self, function: Any, python_calls: bool) -> None:
        super().__init__(function)
        self._python_calls = python_calls
        self._cache_file = CheckedCacheFile(self._cache_path, function.__qualname__, "")

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is compiled for a signature; where nothing is, say that compiling it takes its time."""
        found = super().load_overload(sig, target_context)
        if found is None and self._python_calls:
            _warn("compiling models, which takes some ten seconds once; `telenano doctor --warm` does it beforehand")
        return found

    def _index_key(self, signature: Any, codegen: Any) -> _Key:
        classes = list(dict.fromkeys(_classes(signature)))
        kinds = (self._py_func, *classes)
        names = [f"{kind.__module__}.{kind.__qualname__}" for kind in kinds]
        # code that checks its indices (NUMBA_BOUNDSCHECK) is other code
        options = (vars(config)["BOUNDSCHECK"], self._python_calls)
        described = repr((sys.implementation.cache_tag, names, signature, codegen.magic_tuple(), *options))
        # The names leave out the line of the function, which numba's names have, because lines above it come and go.
        readable = re.sub(r"[^\w.]", "", names[0].rpartition("services.")[2])
        name = f"{readable}.{hashlib.sha256(described.encode()).hexdigest()[:24]}.nbc"
        return _Key(name, kept_digest({kind.__module__ for kind in kinds}))


def _classes(part: Any) -> Iterator[type]:
    """Yield the classes of the tuples in a signature: numba's types know them, and not what became of their fields."""
    if isinstance(part, tuple | list):
        for inner in part:
            yield from _classes(inner)
    elif isinstance(part, types.Type):
        if isinstance(part, types.BaseNamedTuple):
            # numba declares it for the classes below this one
            named: Any = part
            yield named.instance_class
        for name in ("types", "dtype", "type"):
            yield from _classes(getattr(part, name, None))


def _checked(content: bytes) -> Any:
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise _DamagedError
    return pickle.loads(content)


@cache
def _warn(text: str) -> None:
    """Log a warning once in a process: what happened to the code of one function happens to that of others."""
    logging.getLogger("studies").warning(text)

"""The cache of compiled steps on disk, with a checksum: what is damaged is compiled again, and never run."""

import hashlib
import logging
import pickle
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, IndexDataCacheFile

# of each file: numba's own has no means to notice that a file was cut off or changed
_DIGEST_BYTES = hashlib.sha256().digest_size


class _DamagedError(Exception):
    """A file of the cache does not have the content that was written to it."""


class CheckedCacheFile(IndexDataCacheFile):
    """Index and data files of one function; numba's, but for the digest in front of what is pickled."""

    @property
    def _folder(self) -> Path:
        """The folder of all functions; each package has one in it."""
        return Path(self._cache_path).parent

    def load(self, key: Any) -> Any:
        """Return what was compiled, None where it is absent or damaged."""
        try:
            return super().load(key)
        except _DamagedError:
            self._discard()
            return None

    def save(self, key: Any, data: Any) -> None:
        """Keep what was compiled; where that is not possible it is compiled again the next time."""
        try:
            try:
                super().save(key, data)
            except _DamagedError:
                self._discard()
                super().save(key, data)
        except OSError as error:
            _warn(f"compiled code cannot be kept in {self._folder}: {error.strerror}")

    def _dump(self, obj: Any) -> bytes:
        content: bytes = super()._dump(obj)
        return hashlib.sha256(content).digest() + content

    def _save_index(self, overloads: dict[Any, str]) -> None:
        with self._open_for_write(self._index_path) as file:
            file.write(self._dump((self._version, self._source_stamp, overloads)))

    def _load_index(self) -> dict[Any, str]:
        try:
            version, stamp, overloads = _checked(Path(self._index_path).read_bytes())
        except FileNotFoundError:
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _load_data(self, name: str) -> Any:
        return _checked(Path(self._data_path(name)).read_bytes())

    def _discard(self) -> None:
        _warn(f"the compiled code in {self._folder} was damaged, and is compiled again")
        for path in Path(self._cache_path).glob(self._index_name.removesuffix("nbi") + "*"):
            path.unlink(missing_ok=True)


class CheckedCache(FunctionCache):
    """The cache of one function."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = CheckedCacheFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )


def _checked(content: bytes) -> Any:
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise _DamagedError
    return pickle.loads(content)


@cache
def _warn(text: str) -> None:
    """Log a warning once in a process: what happened to the code of one function happens to that of others."""
    logging.getLogger("studies").warning(text)

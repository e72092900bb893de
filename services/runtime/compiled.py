"""The one place where pure steps meet the compiler.

`@compiled` is `numba.njit(cache=True)` with a type that mypy understands. Numba notices a change of the file a
function stands in, but not of the functions it calls from other files, so a plain cache would go on running an
old model after an edit. The cache folder here is named after a digest of every source that compiled code can
depend on: any edit gives a new folder, and a run on unchanged sources loads in milliseconds.
"""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba
from numba.core import config as numba_config

F = TypeVar("F", bound=Callable[..., object])

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("services/haptic_node", "services/afm_node", "services/controller", "studies")
_SHELLS = ("node.py", "__main__.py")


def source_digest(root: Path = _ROOT) -> str:
    """Give the digest (16 hex digits) of every Python file that may hold compiled steps or constants they use."""
    digest = hashlib.sha256(numba.__version__.encode())
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if path.name not in _SHELLS:
                digest.update(str(path.relative_to(root)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_directory(root: Path = _ROOT) -> Path:
    """Give the folder of compiled code for the sources as they are now."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "telenano" / f"numba-{source_digest(root)}"


if "NUMBA_CACHE_DIR" not in os.environ:
    vars(numba_config)["CACHE_DIR"] = str(cache_directory())


def compiled(function: F) -> F:
    """Compile a pure function; under NUMBA_DISABLE_JIT=1 it stays plain Python."""
    return cast(F, numba.njit(cache=True)(function))

"""Whether the import of a module of an installed package comes back: tried once in a process of its own.

A module that calls `os._exit`, or that waits for something, would end or hold up every command and every node, also
those that do not use it. What came of the trial is kept until a file of the package changes; it costs the start of
Python and the import of the module.

Run with the name of a module, this imports it and ends with an exit code that nothing else has.
"""

import hashlib
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

LIMIT_S = 20.0
# an import that hung may have waited for a machine that was away
RETRY_S = 300.0
_CAME_BACK = 97


def import_problem(package: str, version: str, module: str, files: Iterable[tuple[str, Path]]) -> str:
    """Return why a module cannot be imported here without ending or holding up the process; empty where it can.

    Args:
        package: The name of the package, under which the result is kept.
        version: The version of the package.
        module: The module to import.
        files: Name and path of each file of the package; empty if the package cannot be found, whose import then says
            so.
    """
    described = [f"{name} {found.st_size} {found.st_mtime_ns}" for name, path in files for found in [path.stat()]]
    if not described:
        return ""
    key = hashlib.sha256("\n".join([sys.version, sys.prefix, version, *described]).encode()).hexdigest()
    kept = _kept_in(package, module)
    found = _kept(kept, key)
    if found is None:
        found = _tried(module)
        _keep(kept, key, found)
    return found


def cache_folder() -> Path:
    """Return the folder in which it is kept what came of trials: one of a user's own."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "telenano" / "packages"


def _kept_in(package: str, module: str) -> Path | None:
    try:
        return cache_folder() / f"{hashlib.sha256(f'{package} {module}'.encode()).hexdigest()[:24]}.json"
    # A user without a home folder keeps nothing, and tries each time.
    except (OSError, RuntimeError):
        return None


def _kept(path: Path | None, key: str) -> str | None:
    try:
        document = json.loads(path.read_text(encoding="utf-8")) if path is not None else {}
        if document.get("key") != key or (document["problem"] and time.time() - document["tried_s"] > RETRY_S):
            return None
        return str(document["problem"])
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def _keep(path: Path | None, key: str, problem: str) -> None:
    if path is None:
        return
    new = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        new.write_text(json.dumps({"key": key, "problem": problem, "tried_s": time.time()}), encoding="utf-8")
        new.replace(path)
    # it is tried again the next time
    except OSError:
        return


def _tried(module: str) -> str:
    command = [sys.executable, "-P", "-m", __name__, module]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    nothing = subprocess.DEVNULL
    try:
        code = subprocess.run(
            command, stdin=nothing, stdout=nothing, stderr=nothing, env=environment, timeout=LIMIT_S, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        again = f"it is tried again after {RETRY_S / 60.0:g} min, or when one of its files has changed"
        return f"its import did not end within {LIMIT_S:g} s; {again}"
    if code == _CAME_BACK:
        return ""
    how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
    return f"its import ends the whole program, {how}"


def main() -> None:
    """Import the module that the command line names; what it raises is told by who imports it next."""
    from presets import plugins

    # The module may import what loads packages, and one of the others may be the one that hangs.
    plugins.leave_out_packages()
    try:
        importlib.import_module(sys.argv[1])
    except BaseException:  # noqa: BLE001
        os._exit(_CAME_BACK)
    os._exit(_CAME_BACK)


if __name__ == "__main__":
    main()

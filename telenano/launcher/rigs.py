"""Several rigs on one machine: each has its own name, its own folder for sockets, and its own processors.

Names and processors are reserved by file locks of the kernel, which the processes of the rig inherit. They are free
again when the last of these processes has ended, even if it was killed.
"""

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from telenano.files.atomic_files import write_whole
from telenano.files.optional_modules import optional_module
from telenano.launcher import processors
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.endpoint_lock import EndpointInUseError, EndpointLock
from telenano.runtime.bus.holders import look
from telenano.runtime.bus.local_endpoint import (
    FIRST_RIG,
    RIG_VARIABLE,
    RUNTIME_DIRECTORY_VARIABLE,
    base_and_rig,
    base_directory,
    folder_identity,
    rig_directory,
    rigs_with_folders,
)
from telenano.runtime.bus.pin import Pin
from telenano.runtime.loop.realtime import NO_PROCESSORS, PROCESSORS_VARIABLE, may_use_fifo
from telenano.runtime.security.private_files import check_runtime_directory
from telenano.settings.scenario import RealtimeConfig
from telenano.signals.children import permitted
from telenano.wire.errors import ConfigError, EndpointError, RigError
from telenano.wire.nodes import site_of

if TYPE_CHECKING:
    # The import is for types only, because a command that lists running rigs does not need the models of nodes.
    from telenano.launcher.plan import Plan

fcntl = optional_module("fcntl")
_NAMES = (FIRST_RIG, *map(str, range(2, 100)))
# Longest wait for the nodes of a killed launcher to end [s]; they make their devices safe meanwhile.
_ENDING_S = 15.0
# Longest wait for another command that only inspects or cleans up the name of a rig [s].
_GLANCE_S = 1.0
# Interval between attempts to lock a name [s].
_LOOK_S = 0.1
_LOCK = "rig@"
_NEEDED = {"slave": 1}


class RigFacts(NamedTuple):
    """A running rig: `about` is the description written by its launcher, or only its process id if that is unreadable.

    `folder` is the runtime directory with the folders of its user's rigs, empty if it is that of this process.
    """

    name: str
    site: str
    about: dict[str, Any]
    folder: str = ""


class RigName:
    """The lock of the name of a rig, and the file beside it in which the rig describes itself."""

    def __init__(self, name: str, lock: EndpointLock, plan: "Plan", about: Mapping[str, Any]) -> None:
        """Write the file; RigError if that fails."""
        self._file, self._lock, self._about = _about_file(name, site_of(plan.launcher)), lock, dict(about)
        self._pin = self._written()

    def lost(self) -> str:
        return self._lock.lost() or ("" if self._pin.is_in_place() else str(self._file))

    def make_again(self) -> None:
        if self._lock.lost():
            self._lock.make_again()
        self._rewrite()

    def note(self, **facts: str) -> None:
        """Add or update facts in the description of the rig; RigError if the file cannot be written."""
        if any(self._about.get(name) != value for name, value in facts.items()):
            self._about |= facts
            self._rewrite()

    def _rewrite(self) -> None:
        before, self._pin = self._pin, self._written()
        before.close()

    def remove(self) -> None:
        """Remove the file if it is still that of this rig."""
        self._pin.remove()

    def _written(self) -> Pin:
        try:
            write_whole(self._file, json.dumps(self._about).encode(), is_forced=False)
            return Pin(self._file)
        except OSError as error:
            raise RigError(f"{self._file.parent}: cannot be written: {error.strerror}") from error


class Own(NamedTuple):
    """The name and the processors that this rig has reserved, and the descriptors that its processes inherit.

    `place` is the lock of the name, which the launcher restores if it is removed.
    """

    name: str
    processors: tuple[int, ...] = ()
    descriptors: tuple[int, ...] = ()
    place: RigName | None = None


@contextlib.contextmanager
def own_rig(plan: "Plan", show: Callable[[str], Any], lock_folder: Path | None = None) -> Iterator[Own]:
    """Reserve a name and processors for a rig while the block runs; its processes find both in their environment.

    Args:
        plan: The planned rig. With nodes on other machines it only takes the given or the first name, and with sockets
            in the folders of its site file no name at all.
        show: Called with sentences for the user: another name than the first one, or processors that are not free.
        lock_folder: The folder of the locks of processors; that of the machine if None.

    Yields:
        The reserved name, processors and descriptors.

    Raises:
        RigError: A rig of the given name runs.
        ConfigError: The folder of the rig cannot be used.
    """
    if plan.attach:
        # The nodes run already, with the folder and the processors of their own launcher.
        yield Own(os.environ.get(RIG_VARIABLE, FIRST_RIG))
        return
    with contextlib.ExitStack() as stack:
        stack.enter_context(_environment_kept())
        name = FIRST_RIG
        held: tuple[int, ...] = ()
        if plan.book.uses_runtime_directory:
            name, lock = _named(plan, show)
            stack.callback(_leave, name, lock)
            # Check the site file again, because the paths of sockets are longer than for the first rig.
            AddressBook.load(plan.site_file)
            held = lock.descriptors
            _remove_stale_folders(name, plan.launcher)
        claimed, behind = _claim(plan, show, lock_folder or processors.shared_folder())
        stack.callback(processors.release, claimed)
        place: RigName | None = None
        if plan.book.uses_runtime_directory:
            about = _described(plan, tuple(sorted(claimed)), behind=behind)
            place = RigName(name, lock, plan, about)
            stack.callback(place.remove)
        yield Own(name, tuple(sorted(claimed)), (*held, *claimed.values()), place)


@contextlib.contextmanager
def _environment_kept() -> Iterator[None]:
    names = (RIG_VARIABLE, PROCESSORS_VARIABLE)
    before = {name: os.environ.get(name) for name in names}
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def _named(plan: "Plan", show: Callable[[str], Any]) -> tuple[str, EndpointLock]:
    """Lock the given name, or else the first free one, and set it in the environment of this process."""
    named = os.environ.get(RIG_VARIABLE, "")
    # A rig that spans machines keeps its name, because the ports of its site file are the same under any name.
    may_move = not named and not plan.book.spans_machines
    names, begun_s = iter(_NAMES if may_move else (named or FIRST_RIG,)), time.monotonic()
    passed, name = "", next(names)
    while True:
        os.environ[RIG_VARIABLE] = name
        check_runtime_directory(make=True)
        try:
            lock = EndpointLock(f"ipc://{rig_directory(name)}/{_LOCK}{site_of(plan.launcher)}")
        except EndpointInUseError as error:
            # The holder may be a command that only inspects the name or cleans up after a killed rig: wait briefly.
            runs = may_move and str(about_rig(name, site_of(plan.launcher)).get("process")) == error.holder
            patience_s = _ENDING_S if _has_ended(error.holder) else 0.0 if runs else _GLANCE_S
            if time.monotonic() - begun_s < patience_s:
                time.sleep(_LOOK_S)
                continue
            passed = passed or f"rig {name} is in use by process {error.holder}"
            name, begun_s = next(names, ""), time.monotonic()
            if not name:
                hint = "stop it, or give this one another name by --rig NAME"
                raise RigError(f"{passed}: {hint}; `telenano status --all` lists the rigs") from error
            continue
        if passed:
            show(f"{passed}; this one is rig {name}: other commands reach it with --rig {name}")
        return name, lock


def _has_ended(holder: str) -> bool:
    """Return whether the launcher that took a lock is gone; its nodes then hold the lock until they end."""
    try:
        os.kill(int(holder), 0)
    except ProcessLookupError:
        return True
    except (ValueError, PermissionError):
        return False
    return False


def _leave(name: str, lock: EndpointLock) -> None:
    """Release the name, and remove the folder of the rig unless it is that of the first."""
    lock.release()
    if name != FIRST_RIG:
        with contextlib.suppress(OSError):
            rig_directory(name).rmdir()


def _claim(plan: "Plan", show: Callable[[str], Any], folder: Path) -> tuple[dict[int, int], bool]:
    """Lock processors for the nodes of the loop and set them in the environment.

    Returns:
        The locks by processor, and whether the rig runs behind other rigs, on the processor time that they leave.
    """
    os.environ.pop(PROCESSORS_VARIABLE, None)
    config = plan.scenario.realtime_in_force()
    usable = permitted()
    if isinstance(config.cpus, dict):
        claimed = processors.claim_these(config.cpus.values(), folder)
        if others := sorted(set(config.cpus.values()) - set(claimed)):
            show(f"warning: realtime.cpus: other rigs use processors {_list(others)} too, and both will be late there")
        return claimed, False
    if config.cpus == "free" or len(usable) < processors.FOR_A_RIG or not _wants_fifo(config):
        return {}, False
    needed = _NEEDED.get(plan.site or "", processors.FOR_A_RIG)
    claimed = processors.claim(needed, usable, folder)
    if claimed:
        os.environ[PROCESSORS_VARIABLE] = ",".join(map(str, sorted(claimed)))
        return claimed, False
    taken = _list(processors.held(usable, folder))
    text = f"warning: this rig needs {needed} free processors: other rigs use processors {taken} of {len(usable)}"
    if plan.site is not None:
        show(f"{text}; it shares theirs, and all of them may be late")
        return {}, False
    os.environ[PROCESSORS_VARIABLE] = NO_PROCESSORS
    show(
        f"{text}; it runs behind them on what they leave, and may not reach its rate: end one of them "
        "(`telenano status --all` lists them), or give a lower realtime.rate_hz"
    )
    return {}, True


def _wants_fifo(config: RealtimeConfig) -> bool:
    """Return whether the nodes run under SCHED_FIFO; without it they are not bound to processors."""
    return config.scheduler != "normal" and may_use_fifo(config.priority)


def _list(numbers: Any) -> str:
    return ", ".join(map(str, numbers)) or "none"


def _about_file(name: str, site: str) -> Path:
    return rig_directory(name) / f"{_LOCK}{site}.json"


def _described(plan: "Plan", claimed: tuple[int, ...], *, behind: bool) -> dict[str, Any]:
    """Return the description of this rig that `telenano status` shows."""
    return {
        "process": os.getpid(),
        "scenario": plan.scenario.name,
        "begun_s": time.time(),
        "out": str(plan.out),
        "processors": claimed,
        "behind": behind,
    }


def running_rigs() -> list[RigFacts]:
    """Return the rigs of this user that run on this machine, one for each launcher.

    If TELENANO_RUNTIME_DIR is set, only those of that folder are listed, else those of all folders. A rig is detected
    by the lock of its name, which its processes hold even if the lock file was removed.
    """
    here, elsewhere = _rigs_by_folder()
    return [*here, *elsewhere] if lists_all_folders() else here


def lists_all_folders() -> bool:
    """Return whether rigs in all folders are listed, because TELENANO_RUNTIME_DIR is not set for this process."""
    return not os.environ.get(RUNTIME_DIRECTORY_VARIABLE)


def rigs_elsewhere() -> list[RigFacts]:
    """Return the rigs of this user whose runtime directory is not that of this process."""
    return _rigs_by_folder()[1]


def _rigs_by_folder() -> tuple[list[RigFacts], list[RigFacts]]:
    here: dict[tuple[str, str], RigFacts] = {}
    for name in rigs_with_folders():
        for lock in sorted(rig_directory(name).glob(f"{_LOCK}*.lock")):
            site = lock.name.removeprefix(_LOCK).removesuffix(".lock")
            if _is_held(lock):
                here[name, site] = RigFacts(name, site, about_rig(name, site))
    elsewhere: dict[tuple[str, str], RigFacts] = {}
    for holder in look().holders:
        if not holder.node.startswith(_LOCK):
            continue
        site = holder.node.removeprefix(_LOCK)
        base, name = base_and_rig(holder.folder)
        if folder_identity(base) == folder_identity(base_directory()):
            key, of_folder, where = (name, site), here, ""
        else:
            key, of_folder, where = (str(holder.rig), site), elsewhere, str(base)
        if key not in of_folder:
            about = _read_about(holder.folder / f"{_LOCK}{site}.json")
            of_folder[key] = RigFacts(name, site, about or {"process": int(holder.owner)}, where)
    return list(here.values()), list(elsewhere.values())


def about_rig(name: str, site: str = "master") -> dict[str, Any]:
    """Return the description that the launcher of a rig wrote; empty if none can be read."""
    return _read_about(_about_file(name, site))


def _read_about(file: Path) -> dict[str, Any]:
    try:
        about = json.loads(file.read_text())
    except (OSError, ValueError):
        return {}
    return about if isinstance(about, dict) else {}


def _is_held(lock: Path) -> bool:
    try:
        with lock.open() as file:
            # The lock is shared, so that two processes that inspect it do not mistake each other for a rig.
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _remove_stale_folders(own: str, launcher: str) -> None:
    """Remove the folders of killed rigs of which no process runs any more."""
    for name in rigs_with_folders():
        if name not in (own, FIRST_RIG):
            _remove_if_stale(rig_directory(name), f"{_LOCK}{site_of(launcher)}")


def _remove_if_stale(folder: Path, first: str) -> None:
    with contextlib.suppress(EndpointError, ConfigError, OSError):
        # Hold the name meanwhile, so that no rig starts in the folder.
        name = EndpointLock(f"ipc://{folder / first}")
        try:
            if any(_is_held(lock) for lock in folder.glob("*.lock") if lock.name != f"{first}.lock"):
                return
            own, runs = os.getpid(), folder_identity(folder)
            if any(each.process != own and folder_identity(each.folder) == runs for each in look().holders):
                # The rig still runs, although its lock files were removed.
                return
            for path in folder.iterdir():
                if path.name != f"{first}.lock":
                    path.unlink()
        finally:
            name.release()
        folder.rmdir()

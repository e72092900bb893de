"""Real-time settings of a process, so that a 1 kHz loop keeps its deadlines: scheduling, memory lock, processors."""

import contextlib
import ctypes
import gc
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from pydantic import BaseModel

from telenano.files.optional_modules import optional_module
from telenano.runtime.loop.log import StructuredLog
from telenano.settings.scenario import RealtimeConfig
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import name_of

# Windows has no such module.
resource = optional_module("resource")
_PR_SET_TIMERSLACK = 29
# Pages are locked when they are first touched: locking every reserved page would take 400 MB per process.
_MCL_CURRENT_FUTURE_ONFAULT = 7
# Limit of open files, far above the need of a rig; libzmq scans no table of descriptors, so the size costs nothing.
_MOST_FILES = 65_536
# Niceness of processes that run ahead of ordinary ones; the nodes of the loop are ahead of both by SCHED_FIFO.
_BESIDE_THE_LOOP_NICENESS = -5
# Niceness of observers: a display may be late, haptics may not.
_OBSERVER_NICENESS = 5
_MAPS = Path("/proc/self/maps")
_HUGE_PAGE = 2 << 20
_MADV_COLLAPSE = 25
_TASKS = Path("/proc/self/task")
# The processors that this process could use before `auto` pinned it to one of them.
_permitted_before: set[int] = set()
_CPU_DMA_LATENCY = Path("/dev/cpu_dma_latency")
# Environment variable with the processors that the launcher of a rig holds for it, as numbers with commas.
PROCESSORS_VARIABLE = "TELENANO_PROCESSORS"
# Value of the variable if no processor was left: the rig then runs at a lower priority than the other rigs.
NO_PROCESSORS = "none"
# Difference of that priority; a difference of one is that of `lower_thread`.
_BEHIND_RIGS = 2


class RealtimeStatus(BaseModel):
    """The real-time settings that were granted."""

    fifo: bool
    memory_locked: bool


def is_linux() -> bool:
    """Return whether this system is Linux, with its calls for scheduling and memory."""
    return sys.platform == "linux"


def apply_realtime(config: RealtimeConfig | None, log: StructuredLog, node: str) -> RealtimeStatus:
    """Request scheduling, memory lock and fine timers; to call before making a ZeroMQ context, which inherits them.

    Args:
        config: The requested settings; None for the defaults of a rig.
        log: Gets a warning for each setting that is not permitted.
        node: The node as node@site, which selects the processor.

    Raises:
        ConfigError: `fifo` or `on` is configured but not permitted, or the processor cannot be used.
    """
    config = config or RealtimeConfig()
    if not is_linux():
        if config.scheduler == "fifo" or config.memory_lock == "on":
            raise ConfigError(f"realtime: {sys.platform} has no real-time scheduling: give scheduler auto or normal")
        log.info("without real-time scheduling: this system has none", system=sys.platform)
        return RealtimeStatus(fifo=False, memory_locked=False)
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    own = os.environ.get(PROCESSORS_VARIABLE, "")
    behind = own == NO_PROCESSORS
    fifo = config.scheduler != "normal" and _set_fifo(config, log, max(1, config.priority - _BEHIND_RIGS * behind))
    permitted = os.sched_getaffinity(0)
    usable = permitted & _numbers(own) or permitted
    cpu = None if behind else processor_of(node, config, sorted(usable))
    if len(usable) == 1 < len(permitted) and config.cpus == "auto":
        cpu = next(iter(usable))
    # Without SCHED_FIFO a process must be able to leave a busy processor, unless the scenario pins it there.
    if cpu is not None and (fifo or isinstance(config.cpus, dict)):
        _stay_on(cpu)
        if not isinstance(config.cpus, dict):
            _permitted_before.update(permitted)
    locked = config.memory_lock != "off" and _lock_memory(libc, config, log)
    return RealtimeStatus(fifo=fifo, memory_locked=locked)


def processor_of(node: str, config: RealtimeConfig, permitted: Sequence[int]) -> int | None:
    """Return the processor to which a node (node@site) is pinned, None for any of the permitted ones.

    Without pinning, the scheduler moves real-time threads between processors at almost every message; with it, the
    measured age of messages was a quarter less. The two sides meet at the link, so only two of the eight hops change
    the processor, whichever side the link is on.
    """
    if isinstance(config.cpus, dict):
        return config.cpus.get(node, config.cpus.get(name_of(node)))
    if config.cpus == "free" or len(permitted) < 2:
        return None
    # The last processors are chosen because the first tend to serve the machine's interrupts.
    masters, slaves = permitted[-2:]
    at_master = node.endswith("@master") and (config.cpus == "link_at_master" or not node.startswith("delay_node"))
    return masters if at_master else slaves


def on_one_processor(config: RealtimeConfig, nodes: Sequence[str], first: str) -> RealtimeConfig:
    """Return the settings for a process of several nodes, with the processor of any of them given to `first`.

    Raises:
        ConfigError: The scenario pins two of the nodes to different processors.
    """
    if not isinstance(config.cpus, dict):
        return config
    wanted = {node: cpu for node in nodes if (cpu := processor_of(node, config, ())) is not None}
    if len(set(wanted.values())) > 1:
        text = ", ".join(f"{node} on {cpu}" for node, cpu in wanted.items())
        raise ConfigError(f"realtime.cpus: {text}: with realtime.processes site they are one process, on one processor")
    return config.model_copy(update={"cpus": dict.fromkeys([first] if wanted else [], next(iter(wanted.values()), 0))})


def has_fifo() -> bool:
    """Return whether this thread has SCHED_FIFO."""
    return is_linux() and os.sched_getscheduler(0) == os.SCHED_FIFO


def may_use_fifo(priority: int) -> bool:
    """Return whether this process, and thus its children, may use SCHED_FIFO at a priority; tries it for a moment."""
    if not is_linux():
        return False
    policy, granted = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return False
    os.sched_setscheduler(0, policy, granted)
    return True


@contextlib.contextmanager
def on_time() -> Iterator[None]:
    """Make waits of this thread, and of threads that it starts meanwhile, end on time while the block runs.

    Waits of an ordinary thread end up to 50 us late because of its timer slack. SCHED_FIFO, if permitted, keeps other
    processes off its processor.
    """
    if not is_linux():
        yield
        return
    libc = ctypes.CDLL(None, use_errno=True)
    policy, granted = os.sched_getscheduler(0), os.sched_getparam(0)
    libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    try:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(RealtimeConfig().priority))
        yield
    finally:
        os.sched_setscheduler(0, policy, granted)
        # 0 restores the initial slack.
        libc.prctl(_PR_SET_TIMERSLACK, 0, 0, 0, 0)


def _numbers(text: str) -> set[int]:
    """Return the numbers in a list with commas; other entries are ignored."""
    return {int(part) for part in text.split(",") if part.isdigit()}


@contextlib.contextmanager
def ordinary_scheduling() -> Iterator[None]:
    """Leave SCHED_FIFO while the block runs, for long work at the start that must not block others on this processor.

    It changes only this thread, and threads that it starts meanwhile.
    """
    if not has_fifo():
        yield
        return
    granted = os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_FIFO, granted)


def ahead_of_others() -> None:
    """Raise the priority above ordinary processes if permitted, for a process that has to keep up with the loop."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _BESIDE_THE_LOOP_NICENESS)


def behind_others() -> None:
    """Lower the priority below ordinary processes, for a process that only displays."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _OBSERVER_NICENESS)


def lower_thread(name: str) -> None:
    """Put a thread of this process one SCHED_FIFO priority below the others, and let it use any processor.

    SCHED_FIFO threads of the same priority and processor change only when one waits: a thread that always has work
    would block the others. On another processor it need not wait for them; a configured processor is kept.

    Args:
        name: The name of the thread, as in /proc.
    """
    if not has_fifo():
        return
    lower = os.sched_param(max(1, os.sched_getparam(0).sched_priority - 1))
    for task in _TASKS.iterdir():
        # The thread may have ended meanwhile.
        with contextlib.suppress(OSError):
            if (task / "comm").read_text().strip() == name:
                os.sched_setscheduler(int(task.name), os.SCHED_FIFO, lower)
                if _permitted_before:
                    os.sched_setaffinity(int(task.name), _permitted_before)


def freeze_garbage(*, disable: bool = True) -> None:
    """Collect garbage, freeze all objects, and disable the collector, because a full collection takes 10 to 200 ms."""
    gc.collect()
    gc.freeze()
    if disable:
        gc.disable()


def use_huge_pages() -> int:
    """Move the heap of this process to huge pages if the kernel can, and return their number.

    A node wakes up a thousand times a second, after others have used its processor, and touches its whole working set:
    with pages of 4 kB the processor repeats thousands of address translations, each by two tables in a virtual machine.
    """
    if not is_linux():
        return 0
    libc = ctypes.CDLL(None, use_errno=True)
    libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    libc.mincore.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
    page, count = os.sysconf("SC_PAGE_SIZE"), 0
    present = (ctypes.c_ubyte * (_HUGE_PAGE // page))()
    for line in _MAPS.read_text().splitlines():
        place, access, _, _, inode, *name = line.split(maxsplit=5)
        if access != "rw-p" or inode != "0" or (name and name[0] != "[heap]"):
            continue
        first, last = (int(end, 16) for end in place.split("-"))
        for start in range(-(-first // _HUGE_PAGE) * _HUGE_PAGE, last - _HUGE_PAGE + 1, _HUGE_PAGE):
            # A huge page is made only of a range that is mostly in use, because it would waste memory elsewhere.
            if libc.mincore(start, _HUGE_PAGE, present) == 0 and bytes(present).count(1) > len(present) // 2:
                count += libc.madvise(start, _HUGE_PAGE, _MADV_COLLAPSE) == 0
    return count


def raise_file_limit() -> None:
    """Raise the limit of open files as far as permitted, so that clients that only connect cannot use them up."""
    if resource is None:
        return
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(most, _MOST_FILES), most))


@contextlib.contextmanager
def shallow_idle() -> Iterator[bool]:
    """Keep the processors out of deep idle states while the block runs; yield whether that was permitted."""
    try:
        descriptor = os.open(_CPU_DMA_LATENCY, os.O_WRONLY)
    except OSError:
        yield False
        return
    try:
        os.write(descriptor, (0).to_bytes(4, "little"))
        yield True
    finally:
        os.close(descriptor)


def _stay_on(cpu: int) -> None:
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError as error:
        processors = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        raise ConfigError(
            f"realtime.cpus: {cpu} cannot be used ({error.strerror}), permitted processors are {processors}"
        ) from error


def _set_fifo(config: RealtimeConfig, log: StructuredLog, priority: int) -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError as error:
        if config.scheduler == "fifo":
            raise ConfigError(
                "realtime.scheduler: fifo is not permitted: run as root, raise `ulimit -r`, or set it to auto"
            ) from error
        log.warning(
            "SCHED_FIFO is not permitted, the loop may run late under load: run as root, "
            "raise `ulimit -r`, or give a container `ulimits: {rtprio: 99}` (RTPRIO=99 in .env of the compose files)"
        )
        return False
    return True


def _lock_memory(libc: ctypes.CDLL, config: RealtimeConfig, log: StructuredLog) -> bool:
    if libc.mlockall(_MCL_CURRENT_FUTURE_ONFAULT) == 0:
        return True
    if config.memory_lock == "on":
        reason = os.strerror(ctypes.get_errno())
        raise ConfigError(
            f"realtime.memory_lock: memory cannot be locked ({reason}): raise `ulimit -l`, or set it to auto"
        )
    log.warning("memory cannot be locked, a page fault may delay the loop: raise `ulimit -l`")
    return False

"""The checks of `telenano doctor`: each takes facts as arguments and returns a finding with advice."""

import ctypes
import errno
import fcntl
import re
import socket
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from telenano.extend.checks import Finding, Level
from telenano.launcher.processors import FOR_A_RIG, fits_text
from telenano.settings.known_packages import where_it_is
from telenano.signals import children
from telenano.wire.errors import ConfigError
from telenano.wire.extras import extra_in

if TYPE_CHECKING:
    from telenano.runtime.security.keyring import Keyring


_OLDEST_PYTHON = (3, 11)
_LEAST_PROCESSORS = 2
_PRIORITY = 50
_LEAST_DISK_BYTES = 10**9
# Extras that are not listed: for developers of the project, or the sum of all others.
_NOT_LISTED = ("dev", "rig")
_ENDPOINT_ADVICE: dict[str, tuple[Level, str]] = {
    "in use": (
        "warning",
        "leave it if a rig runs; else end the process that `ss -tlnp` names, or set another port in the site file",
    ),
    "unusable": (
        "problem",
        "set this machine's own address in the site file or by TELENANO_HOST_NAME, or one to bind by "
        "TELENANO_BIND_ADDRESS; where this is another machine, name it by TELENANO_MACHINE",
    ),
}
_TCP = re.compile(r"tcp://(?P<host>.+):(?P<port>[0-9]+)")


class KernelClock(NamedTuple):
    """State of the kernel clock: whether a time service disciplines it, and the bound of its error [s]."""

    synchronised: bool
    largest_error_s: float


class Endpoint(NamedTuple):
    """Result of an attempt to bind an endpoint: free, held by a rig, held by another program, or unusable here."""

    state: Literal["free", "rig", "in use", "unusable"]
    detail: str = ""


def check_python(version: Sequence[int]) -> Finding:
    """Check the version of the interpreter."""
    running = ".".join(map(str, version))
    if tuple(version[:2]) >= _OLDEST_PYTHON:
        return Finding("python", "ok", running)
    oldest = ".".join(map(str, _OLDEST_PYTHON))
    return Finding("python", "problem", running, f"install Python {oldest} or later and make the environment again")


def check_advisers(installed: Collection[str]) -> Finding:
    """Report whether an installed package warns of sessions outside of the proven limits of their law."""
    if installed:
        return Finding("advice", "ok", f"sessions are watched by {', '.join(installed)}")
    found = "no package watches sessions: nothing is warned of where one is outside of what its law was shown to hold"
    return Finding("advice", "ok", found, where_it_is("adviser benchmark"))


def check_packages(requires: Iterable[str], installed: Callable[[str], str | None]) -> list[Finding]:
    """Compare the installed packages with the project's requirements; a missing extra is not a problem.

    Args:
        requires: Requirements such as `numba>=0.61; extra == 'afm'`.
        installed: Function that returns the version of a package, None if it is missing.
    """
    try:
        from packaging.requirements import Requirement
    except ImportError:
        return [Finding("packages", "warning", "versions cannot be compared", "run `pip install packaging`")]
    wanted = [(extra_in(requirement.marker), requirement) for requirement in map(Requirement, requires)]
    wanted = [(extra, requirement) for extra, requirement in wanted if extra not in _NOT_LISTED]
    versions = {requirement.name: installed(requirement.name) for _, requirement in wanted}
    # Several extras may require the same package.
    demands = {requirement.name: requirement.specifier for _, requirement in wanted}
    wrong = [
        Finding(name, "problem", f"{version} is installed", f'run `pip install "{name}{demands[name]}"`')
        for name, version in versions.items()
        if version is not None and not demands[name].contains(version, prereleases=True)
    ]
    missing: dict[str, list[str]] = {}
    for extra, requirement in wanted:
        if versions[requirement.name] is None:
            missing.setdefault(extra, []).append(requirement.name)
    absent = [Finding(name, "problem", "not installed", f"run `pip install {name}`") for name in missing.pop("", ())]
    listed = ", ".join(f"{name} {version}" for name, version in sorted(versions.items()) if version)
    lacking = "".join(f"\n{extra:<12}lacks {', '.join(names)}" for extra, names in sorted(missing.items()))
    return [
        *wrong,
        *absent,
        Finding("packages", "ok", listed or "none"),
        Finding("extras", "ok", f"{len(missing)} not installed:{lacking}" if lacking else "all are installed"),
    ]


def check_processors(permitted: int, quota: float | None) -> Finding:
    """Check the number of processors that this process may use, by affinity and by the quota of its control group."""
    text = f"{permitted} permitted" + ("" if quota is None else f", quota of {quota:g}")
    if min(permitted, permitted if quota is None else quota) >= _LEAST_PROCESSORS:
        return Finding("processors", "ok", text)
    advice = f"give the rig {_LEAST_PROCESSORS} or more: a larger machine, `taskset`, or `cpus:` of a container"
    return Finding("processors", "warning", f"{text}; too few for the 1 kHz loops not to disturb each other", advice)


def check_rig_processors(permitted: int, held: Sequence[int]) -> Finding:
    """Check that two processors are free for a further rig, because each running rig holds its own."""
    name, free = "processors of rigs", permitted - len(held)
    if not held:
        return Finding(name, "ok", f"no rig holds processors; {fits_text(free)}")
    text = f"running rigs use processors {', '.join(map(str, held))}; {fits_text(free)}"
    if free >= FOR_A_RIG:
        return Finding(name, "ok", text)
    return Finding(name, "warning", text, "end one of them: `telenano status --all` lists those of this user")


def cpu_quota(groups: Path, membership: Path) -> float | None:
    """Return the least quota [processors] of a process's control groups and their parents; None without a limit.

    Args:
        groups: The mount point of the control groups.
        membership: The file /proc/PID/cgroup.
    """
    quotas = []
    for line in (_text(membership) or "").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        base = groups / "cpu" if controllers else groups
        folder = base / path.lstrip("/")
        # Include the root, because a container sees its own group there, whatever its path says.
        quotas += [_quota_of(part) for part in (folder, *folder.parents) if part.is_relative_to(base)]
    return min((quota for quota in quotas if quota is not None), default=None)


def _quota_of(folder: Path) -> float | None:
    words = (_text(folder / "cpu.max") or "").split()
    if not words:
        words = [_text(folder / "cpu.cfs_quota_us") or "", _text(folder / "cpu.cfs_period_us") or ""]
    if len(words) != 2 or not all(word.isdigit() for word in words):
        return None
    return int(words[0]) / int(words[1])


def check_fifo(refused: str, limit: int, runtime_us: str | None, *, container: bool) -> Finding:
    """Evaluate an attempt to use SCHED_FIFO; `refused` is the reason of its failure, or empty."""
    kernel = f"RLIMIT_RTPRIO {_limit(limit)}, sched_rt_runtime_us {runtime_us or 'unknown'}"
    if not refused:
        return Finding("SCHED_FIFO", "ok", f"permitted; {kernel}")
    if runtime_us == "0":
        advice = "run `sudo sysctl -w kernel.sched_rt_runtime_us=950000`"
    elif container:
        advice = (
            "give the container `ulimits: {rtprio: 99}` (RTPRIO=99 in .env of the compose files), and "
            "`cap_add: [SYS_NICE]` where it runs as root"
        )
    else:
        advice = "run as root, or put `USER - rtprio 99` into /etc/security/limits.d/telenano.conf and log in again"
    return Finding("SCHED_FIFO", "warning", f"not permitted ({refused}), loops run late under load; {kernel}", advice)


def check_memory_lock(refused: str, limit_bytes: int, *, container: bool) -> Finding:
    """Evaluate an attempt to lock as much memory as a node; `refused` is the reason of its failure, or empty."""
    text = "RLIMIT_MEMLOCK " + ("unlimited" if limit_bytes < 0 else f"{limit_bytes / 1e6:.1f} MB")
    if not refused:
        return Finding("memory lock", "ok", f"permitted; {text}")
    if container:
        advice = "give the container `ulimits: {memlock: -1}`, or `cap_add: [IPC_LOCK]` where it runs as root"
    else:
        advice = "run as root, or put `USER - memlock unlimited` into /etc/security/limits.d/telenano.conf "
        advice += "and log in again"
    return Finding("memory lock", "warning", f"not permitted ({refused}), page faults delay loops; {text}", advice)


def attempt_fifo() -> str:
    """Try SCHED_FIFO in a separate process; return the reason of a refusal, empty if it is permitted."""
    return _attempt(f"import os\nos.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param({_PRIORITY}))")


def attempt_memory_lock() -> str:
    """Try to lock memory in a separate process that reserves as much as a node; return the reason of a refusal."""
    # Without privilege the kernel compares all reserved memory, touched or not, with the limit.
    return _attempt(
        "import ctypes, mmap, os\n"
        "reserved = mmap.mmap(-1, 2**30)\n"
        "libc = ctypes.CDLL(None, use_errno=True)\n"
        "if libc.mlockall(7): raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))"
    )


def _attempt(code: str) -> str:
    done = children.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    lines: list[str] = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
    return lines[-1].rpartition("] ")[2]


def check_synchronised(clock: KernelClock | None) -> Finding:
    """Check whether a time service disciplines the clock; `clock` is None if the kernel does not report it."""
    if clock is None:
        return Finding("clock", "ok", "the kernel does not report here whether it is synchronised")
    if clock.synchronised:
        return Finding("clock", "ok", f"synchronised, within {clock.largest_error_s * 1e3:.3g} ms")
    advice = "start a time service on each machine (in a container: on its host): `sudo systemctl enable --now chrony`"
    advice += " or `sudo timedatectl set-ntp true`"
    text = (
        "not synchronised, which matters to a rig on two machines: ages of messages are wrong by the difference, and "
    )
    text += "a report has to rely on the difference that the link measures"
    return Finding("clock", "warning", text, advice)


class _Timex(ctypes.Structure):
    """`struct timex` of adjtimex(2); the fields after `status` are not read."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_long * 32),
    )


def kernel_clock() -> KernelClock | None:
    """Return the state of the kernel clock; None if this process may not read it."""
    # With modes = 0 nothing is changed.
    state = _Timex()
    result = int(ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(state)))
    return None if result < 0 else kernel_clock_of(result, state.status, state.maxerror)


def kernel_clock_of(result: int, status: int, largest_error_us: int) -> KernelClock:
    """Interpret adjtimex(2): result TIME_ERROR (5) or status STA_UNSYNC (0x40) means an undisciplined clock."""
    return KernelClock(result != 5 and not status & 0x40, largest_error_us * 1e-6)


def check_endpoints(endpoints: Mapping[str, str], probe: Callable[[str], Endpoint]) -> list[Finding]:
    """Check whether endpoints can be bound (the values are their nodes); a held ipc endpoint means a running rig."""
    states = {endpoint: probe(endpoint) for endpoint in endpoints}
    free = sum(endpoint_state.state == "free" for endpoint_state in states.values())
    held = [
        f"{endpoints[at]} ({endpoint_state.detail})"
        for at, endpoint_state in states.items()
        if endpoint_state.state == "rig"
    ]
    runs = f"; a rig runs: {', '.join(held)}" if held else ""
    wrong = [at for at, endpoint_state in states.items() if endpoint_state.state in _ENDPOINT_ADVICE]
    return [
        Finding("endpoints", "ok", f"{free} of {len(states)} free{runs}"),
        *(_endpoint_finding(endpoints[endpoint], endpoint, states[endpoint]) for endpoint in wrong),
    ]


def _endpoint_finding(node: str, endpoint: str, state: Endpoint) -> Finding:
    level, advice = _ENDPOINT_ADVICE[state.state]
    return Finding(f"endpoint of {node}", level, f"{endpoint}: {state.detail}", advice)


def check_keys(machine: str, others: Iterable[str], keyring: "Keyring") -> list[Finding]:
    """Check that a machine has its key, knows those of the other machines of a rig, and that none expires soon."""
    try:
        keyring.own_in_force(machine)
        allowed, expiring = keyring.allowed(), keyring.expiring()
    except ConfigError as error:
        # The error text names the command that helps.
        return [Finding("keys", "problem", f"this machine is {machine}: {error}", "correct it with `telenano keys`")]
    unknown = [name for name in sorted(others) if allowed.of_machine(name) is None]
    if expiring:
        advice = (
            "make a new key there (`telenano keys new NAME --replace`) and allow it on the other machines, or give "
        )
        advice += "the key another last day (`telenano keys allow NAME KEY --role ... --expires DATE`)"
        return [Finding("keys", "warning", f"this machine is {machine}; {'; '.join(expiring)}", advice)]
    if not unknown:
        return [Finding("keys", "ok", f"this machine is {machine}; it knows the keys of {', '.join(sorted(others))}")]
    advice = f"copy the public key that `telenano keys show` prints there: `telenano keys allow {unknown[0]} ...`"
    return [Finding("keys", "warning", f"this machine is {machine}; it knows no key of {', '.join(unknown)}", advice)]


def probe_endpoint(endpoint: str) -> Endpoint:
    """Try to bind a tcp endpoint, or to lock the file of an ipc endpoint, and release it at once."""
    match = _TCP.fullmatch(endpoint)
    if match is None:
        return _probe_ipc(Path(endpoint.removeprefix("ipc://") + ".lock"))
    return _probe_tcp(match["host"].strip("[]"), int(match["port"]))


def _probe_ipc(lock_file: Path) -> Endpoint:
    try:
        with lock_file.open() as lock:
            # A shared lock, so that two runs of doctor do not report each other.
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return Endpoint("free")
    except BlockingIOError:
        return Endpoint("rig", f"process {_text(lock_file) or 'unknown'}")
    except OSError as error:
        return Endpoint("unusable", f"{lock_file} cannot be opened ({error.strerror})")
    return Endpoint("free")


def _probe_tcp(host: str, port: int) -> Endpoint:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        return Endpoint("unusable", f"{host} cannot be resolved ({error.strerror})")
    with socket.socket(family, kind, protocol) as attempt:
        # ZeroMQ also sets this option, so that a closed connection does not block the port.
        attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            attempt.bind(address)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return Endpoint("in use", "the port is in use")
            return Endpoint("unusable", f"the port cannot be bound ({error.strerror})")
    return Endpoint("free")


def check_disk(folder: Path, free_bytes: int) -> Finding:
    """Check the free space for recordings [bytes]."""
    text = f"{free_bytes / 1e9:.1f} GB free in {folder}"
    if free_bytes >= _LEAST_DISK_BYTES:
        return Finding("disk", "ok", text)
    return Finding("disk", "warning", text, "free some space, or record elsewhere with `telenano up --out DIR`")


def in_container(root: Path = Path("/")) -> bool:
    """Return whether this process runs in a container of docker or podman."""
    return (root / ".dockerenv").exists() or (root / "run/.containerenv").exists()


def _limit(value: int) -> str:
    return "unlimited" if value < 0 else str(value)


def _text(path: Path) -> str | None:
    try:
        return path.read_text().strip()
    except OSError:
        return None

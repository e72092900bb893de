"""Run a command in the session's container, and leave what a session wrote in ./out, as files of its owner.

The containers of a rig share sockets and recordings as user 10001, who may write nothing else on their machine. So this
starts as root, begins a writer that becomes the owner of ./out, and becomes user 10001 itself before anything else
runs. The writer takes open files from it, one at a time, each with the name that it shall have.
"""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple, NoReturn

from telenano.signals import children

ENTRYPOINT = Path("/opt/entrypoint.py")
RECORDINGS = Path("/recordings")
# The folder ./out of the machine is mounted here.
OUT = Path("/out")
# The user of the machine has made this file, so that its owner is the owner of the results.
PROJECT_FILE = Path("/project/compose.yaml")
RUNTIME = Path("/run/telenano")
ROOT = 0
# that of the Dockerfile
USER = 10001
WRITE = "--write"
EXIT_FAILED = 1
NEXT = (
    "next: Ctrl-C or `docker compose down` ends the nodes, which keep the tip withdrawn; "
    "`SCENARIO=touch docker compose up` lets you press"
)
ADDRESSES = "docker compose exec viz_node telenano view --addresses"
_LONGEST_NAME = 4096
_LONGEST_ANSWER = 1000
_DONE = b"done"


class Owner(NamedTuple):
    """A user of the machine, by the numbers of user and group."""

    user: int
    group: int


def main(command: list[str]) -> None:
    """Run a command as user 10001; what `telenano up` writes is then handed over. Exit with the code of the command."""
    is_session = command[:2] == ["telenano", "up"]
    if os.geteuid() != ROOT or not is_session:
        become_user()
        children.become([sys.executable, str(ENTRYPOINT), *command])
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    owner = owner_of_results(OUT, PROJECT_FILE)
    number = theirs.fileno()
    children.start(
        [sys.executable, __file__, WRITE, str(number)],
        user=owner.user, group=owner.group, extra_groups=[], pass_fds=[number], start_new_session=True,
    )  # fmt: skip
    theirs.close()
    become_user()
    raise SystemExit(run_session(command, ours))


def become_user() -> None:
    """Give up all rights of root for good, where this is root, and work in the folder of recordings."""
    if os.geteuid() == ROOT:
        os.setgroups([])
        os.setgid(USER)
        os.setuid(USER)
    os.chdir(RECORDINGS)


def owner_of_results(out: Path, project_file: Path) -> Owner:
    """Return whose the results shall be: the owner of ./out; where root has it, the owner of the project.

    The engine makes a missing folder as root. It is given to the owner of the project.
    """
    status = out.stat()
    if status.st_uid != ROOT:
        return Owner(status.st_uid, status.st_gid)
    project = project_file.stat()
    if project.st_uid != ROOT:
        os.chown(out, project.st_uid, project.st_gid)
    return Owner(project.st_uid, project.st_gid)


def run_session(command: list[str], writer: socket.socket) -> int:
    """Run `telenano up`, hand over what it wrote, and return its exit code, or that of a failed hand-over."""
    sessions = RECORDINGS / "sessions"
    before = set(sessions.glob("*"))
    # A person at a terminal reads it as it is written, and may answer.
    pipe = None if sys.stdout.isatty() else subprocess.PIPE
    process = children.start([sys.executable, str(ENTRYPOINT), *command], stdout=pipe, text=True, errors="replace")
    ended: list[int] = []

    def end(number: int, frame: object) -> None:
        ended.append(number)
        # Ctrl-C at a terminal reaches the command by itself, and another one would end its report.
        if number == signal.SIGTERM or not sys.stdin.isatty():
            process.send_signal(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    with process:
        for line in process.stdout or ():
            # NEXT replaces it: this machine may lack the command.
            if not line.startswith("next: "):
                tell(in_out(line, sorted(set(sessions.glob("*")) - before)))
    code = process.returncode
    code = code if code >= 0 else 128 - code
    for folder in sorted(set(sessions.glob("*")) - before):
        try:
            names = hand_over(folder, writer)
        except OSError as error:
            tell(
                f"./out/{folder.name} cannot be written: {error.strerror or error}; the session is in the volume of "
                f"recordings, in sessions/{folder.name}: docs/deployment.md says how to copy it\n"
            )
            code = code or EXIT_FAILED
        else:
            tell(f"./out/{folder.name} has {', '.join(names)}\n")
    if not ended:
        # A rig that is stopped as a whole has no page any more.
        tell(f"{page_line(RUNTIME)}\n{NEXT}\n")
    return code


def tell(text: str) -> None:
    """Write to the log at once."""
    sys.stdout.write(text)
    sys.stdout.flush()


def page_line(runtime: Path) -> str:
    """Return where the page of the rig is, and the command that shows its token; or that there is none."""
    lines = [line for file in sorted(runtime.glob("view-*.addresses")) for line in file.read_text().splitlines()]
    address = next((line.partition(": ")[2] for line in lines if line.startswith("operator: ")), "")
    if not address:
        return "page: none is served; the log of viz_node says why"
    # Anyone who may use the engine may read this log.
    return f"page: {address.partition('#')[0]}; `{ADDRESSES}` prints the address with its token"


def recordings_of(summary: Path) -> dict[Path, str]:
    """Return the recordings that a summary names, each with its name in the folder of the session.

    A summary that is just being written, or was left half, names none.
    """
    try:
        recording = json.loads(summary.read_text(encoding="utf-8"))["recording"]
        first = Path(recording["file"])
        files = [first.parent / part["file"] for part in recording.get("parts", ())] or [first]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {file: f"session_{number}.mcap" if number else "session.mcap" for number, file in enumerate(files)}


def in_out(line: str, folders: list[Path]) -> str:
    """Return a line of output with the names that the files of sessions have on the machine.

    The command names them from the root, or from the folder of recordings, in which it runs.
    """
    for summary in (summary for folder in folders for summary in sorted(folder.rglob("summary.json"))):
        place = Path("out") / summary.parent.relative_to(RECORDINGS / "sessions")
        for file, name in recordings_of(summary).items():
            paths = "|".join(re.escape(path) for path in (str(file), os.path.relpath(file, RECORDINGS)))
            line = re.sub(rf"(?<![\w./-])(?:{paths})(?![\w.])", str(place / name), line)
    return re.sub(rf"(?<![\w./-])(?:{RECORDINGS}/)?sessions/", "out/", line)


def hand_over(folder: Path, writer: socket.socket) -> list[str]:
    """Send the files of a session to the writer, with its recordings; return their names in the folder.

    Raises:
        OSError: A file cannot be read, or the writer cannot write it; then the rest is not sent.
    """
    names = []
    for name, file in files_of(folder):
        with file:
            socket.send_fds(writer, [f"{folder.name}/{name}".encode()], [file.fileno()])
        answer = writer.recv(_LONGEST_ANSWER)
        if answer != _DONE:
            raise OSError(answer.decode() or "the process that writes there has ended")
        names.append(name)
    return names


def files_of(folder: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Yield the files of a session, open, with their names in its folder: its recordings, and what is in the folder."""
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        place = path.parent.relative_to(folder)
        if path.name != "summary.json":
            yield str(place / path.name), path.open("rb")
            continue
        with tempfile.TemporaryFile() as changed:
            changed.write(in_out(path.read_text(encoding="utf-8"), [folder]).encode())
            changed.seek(0)
            yield str(place / path.name), changed
        for file, name in recordings_of(path).items():
            if file.is_file():
                yield str(place / name), file.open("rb")


def write(connection: socket.socket, out: Path) -> None:
    """Write each file that comes over a connection below a folder, until it is closed; answer each with its outcome."""
    while True:
        name, descriptors, _, _ = socket.recv_fds(connection, _LONGEST_NAME, 1)
        if not name:
            return
        with os.fdopen(descriptors[0], "rb") as source:
            try:
                write_one(source, out, Path(name.decode()))
            except OSError as error:
                connection.send((error.strerror or str(error)).encode()[:_LONGEST_ANSWER])
                continue
        connection.send(_DONE)


def write_one(source: IO[bytes], out: Path, name: Path) -> None:
    """Write a file below a folder under a name that must not lead out of it; OSError, and no file, where it fails."""
    if name.is_absolute() or ".." in name.parts:
        raise OSError(f"{name}: is not in the folder of results")
    path = out / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("xb") as target:
        try:
            shutil.copyfileobj(source, target, 1 << 20)
            target.flush()
        except OSError:
            # Half a recording must not look like a whole one.
            path.unlink()
            raise


def serve(number: int) -> NoReturn:
    """Write what comes over an inherited connection; signals are for the session, after which it is closed."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    with socket.socket(fileno=number) as connection:
        write(connection, OUT)
    raise SystemExit(0)


if __name__ == "__main__":
    if sys.argv[1:2] == [WRITE]:
        serve(int(sys.argv[2]))
    main(sys.argv[1:])

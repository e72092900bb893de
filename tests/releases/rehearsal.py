"""Try a release from its files alone, as somebody has them who has no copy of the repository.

    python rehearsal.py FOLDER [--before OLD_WHEEL]

FOLDER is what `make dist` leaves. The interpreter that runs this makes an environment outside the repository, under a
home of its own, and does there what docs/install.md says, line by line: install with `--find-links`, run a rig, open
its page, run an experiment, run two sites, read the recording of the release, upgrade and go back, uninstall. No
variable of the caller reaches it but those that lead pip to its registry, and PATH has the folders of the system alone.
Standard library only, so that it runs in a container without anything else. Each step prints a line with its seconds;
the first that fails ends it with what was said, and 1.
"""

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

PATIENCE_S = 1800
# the folders that the wheels put beside one another, and how the names of all begin
PLACES = ("services", "telenano")
PAGE_PORT = 18650
TRIAL = """
import telenano
from telenano.settings import DEMO_RECORDING
session, simulated = telenano.open(DEMO_RECORDING), telenano.simulate("fig12")
rows = len(session.table("afm/state")["time_s"])
assert rows > 100
print(f"the recording that comes with the rig is opened ({rows} samples of the tip, {session.summary['verdict']}), "
      f"and fig12 is simulated ({simulated.verdict})")
"""


class StumbleError(Exception):
    """A step of the rehearsal failed; the text has the command and what it said."""


class Home:
    """A home and an environment in it, in a folder that is nobody's else."""

    def __init__(self, folder: Path, name: str = "rig") -> None:
        self.folder, self.environment = folder, folder / name
        kept = {name: text for name, text in os.environ.items() if name.startswith(("PIP_", "SSL_"))}
        kept.pop("PIP_FIND_LINKS", None)
        self.variables = {**kept, "HOME": str(folder), "PATH": "/usr/bin:/bin", "TMPDIR": str(folder / "tmp")}
        (folder / "tmp").mkdir(exist_ok=True)
        self.run([sys.executable, "-P", "-m", "venv", str(self.environment)])

    def run(self, command: Sequence[str], **more: str) -> str:
        """Run a command to its end in this home; return what it printed, or raise StumbleError."""
        done = subprocess.run(
            command, cwd=self.folder, env={**self.variables, **more}, capture_output=True, text=True,
            timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        if done.returncode:
            said = (done.stderr or done.stdout).strip()[-2000:]
            raise StumbleError(f"{' '.join(command)}: ended with {done.returncode}: {said}")
        return done.stdout

    def pip(self, *words: str) -> str:
        """Run this environment's pip."""
        return self.run([str(self.environment / "bin" / "python"), "-P", "-m", "pip", *words, "--quiet"])

    def telenano(self, *words: str) -> str:
        """Run this environment's telenano."""
        return self.run([str(self.environment / "bin" / "telenano"), *words])

    @contextmanager
    def started(self, *words: str) -> Iterator[None]:
        """Start telenano beside what follows, and stop it at the end as Ctrl-C does; it has to end with 0."""
        command = [str(self.environment / "bin" / "telenano"), *words]
        with tempfile.TemporaryFile("w+") as said:
            process = subprocess.Popen(
                command, cwd=self.folder, env=self.variables, stdout=said, stderr=said, start_new_session=True
            )
            try:
                yield
            finally:
                process.send_signal(signal.SIGINT)
                code = process.wait(PATIENCE_S)
            said.seek(0)
            if code:
                raise StumbleError(f"{' '.join(command)}: ended with {code}: {said.read()[-2000:]}")


def rehearse(home: Home, release: Path, before: Path | None) -> Iterator[str]:
    """Do each step and yield its line."""
    wheels = sorted(release.glob("telenano*.whl"))
    names = [wheel.name.split("-")[0].replace("_", "-") for wheel in wheels]
    packages = [name for name in names if name != "telenano"]
    home.pip("install", "--find-links", str(release), "telenano[rig]")
    yield f"telenano[rig] is installed: {size_of(home.environment)}"
    home.pip("install", "--find-links", str(release), *packages)
    listed = home.telenano("--version")
    if unlisted := [name for name in packages if name not in listed]:
        raise StumbleError(f"telenano --version does not name {', '.join(unlisted)}: {listed}")
    yield f"{len(packages)} packages more, each named by `telenano --version`: {size_of(home.environment)}"
    yield without_an_index(home, release)
    yield recorded(home, "first")
    yield served(home)
    home.telenano("experiment", "run", "delay_and_law", "--apparatus", "lockstep", "--out", "experiment")
    home.telenano("experiment", "analyse", "experiment")
    analysed = list((home.folder / "experiment" / "analysis").iterdir())
    yield f"an experiment in lockstep is run and analysed: {len(analysed)} files"
    yield two_sites(home)
    yield home.run([str(home.environment / "bin" / "python"), "-P", "-c", TRIAL]).strip()
    if before is not None:
        yield from upgraded(Home(home.folder, "before"), home, release, before)
    yield uninstalled(home, names)


def without_an_index(home: Home, release: Path) -> str:
    """Collect the core with what it needs, and install it from that folder alone, as without internet."""
    home.pip("download", "--find-links", str(release), "--dest", "wheels", "telenano")
    offline = Home(home.folder, "offline")
    offline.pip("install", "--no-index", "--find-links", "wheels", "telenano")
    version = offline.telenano("--version").splitlines()[0]
    return f"without an index telenano {version} is installed from a folder of wheels"


def recorded(home: Home, out: str) -> str:
    """Run a rig of real processes and read its summary."""
    rig = ("up", "--scenario", "fig12", "--set", "realtime.rate_hz=500", "--duration", "4", "--headless", "--out", out)
    home.telenano(*rig)
    summary = json.loads((home.folder / out / "summary.json").read_text())
    if not (summary["recording"]["complete"] and summary["recording"]["messages"] > 1000):
        raise StumbleError(f"telenano {' '.join(rig)}: {out}/summary.json has no complete recording of a rig")
    return (
        f"`telenano up` has run a rig of {len(list((home.folder / out / 'logs').iterdir()))} logs: {summary['verdict']}"
    )


def served(home: Home) -> str:
    """Open the page on the demo recording, with the scripts and styles that it names."""
    with home.started("view", "--demo", "--port", str(PAGE_PORT)):
        root = f"http://127.0.0.1:{PAGE_PORT}/"
        page = fetched(root).decode()
        parts = re.findall(r'(?:src|href)="\.?/?([^"]+\.(?:js|css))"', page)
        if not parts:
            raise StumbleError(f"{root}: the page names no script")
        amount = sum(len(fetched(root + part)) for part in parts)
        home.telenano("view", "--addresses")
    return f"`telenano view --demo` serves the page and its {len(parts)} parts ({amount / 1e3:.0f} kB)"


def fetched(address: str) -> bytes:
    """Return what a server sends, waiting for it to start."""
    end = time.monotonic() + 60
    while True:
        try:
            with urllib.request.urlopen(address, timeout=10) as answer:
                return bytes(answer.read())
        except OSError as error:
            if time.monotonic() > end:
                raise StumbleError(f"{address}: {error}") from None
            time.sleep(0.2)


def two_sites(home: Home) -> str:
    """Run both sites on this machine, with keys, as docs/deployment.md has it."""
    keys = home.folder / ".config" / "telenano" / "keys"
    home.telenano("keys", "new", "master")
    home.telenano("keys", "new", "slave")
    home.telenano("keys", "allow", "master", str(keys / "master.key"), "--role", "data", "--role", "control")
    home.telenano("keys", "allow", "slave", str(keys / "slave.key"), "--role", "data")
    rate = ("--scenario", "fig12", "--set", "realtime.rate_hz=200", "--headless")
    with home.started("up", "--site", "slave", *rate, "--out", "slave"):
        summary = json.loads(
            home.telenano("up", "--site", "master", *rate, "--duration", "3", "--json", "--out", "master")
        )
    arrived = summary["completeness"]["teleop/backward@master"]
    if arrived < 0.5:
        raise StumbleError(f"of what the slave sent, the master's recording has {arrived:.0%}")
    return (
        f"two sites with keys: {summary['verdict']}, {arrived:.0%} of what the slave sent is in the master's recording"
    )


def upgraded(old: Home, home: Home, release: Path, before: Path) -> Iterator[str]:
    """Install the wheel of before, upgrade it, and go back; each version reads what the other has recorded."""
    old.pip("install", f"{before}[rig]")
    recorded(old, "of-before")
    home.telenano("bag", "verify", "of-before/session.mcap")
    home.telenano("report", "of-before/session.mcap", "--out", "report-of-before")
    old.pip(
        "install",
        "--force-reinstall",
        "--no-deps",
        "--find-links",
        str(release),
        str(next(release.glob("telenano-*.whl"))),
    )
    recorded(old, "upgraded")
    yield f"{before.name} is upgraded: its recording is verified and reported, and a rig runs in the same environment"
    old.pip("install", "--force-reinstall", "--no-deps", str(before))
    recorded(old, "back")
    old.telenano("bag", "verify", "upgraded/session.mcap")
    yield f"{before.name} is back: a rig runs, and the recording of the newer version is verified"


def uninstalled(home: Home, names: Sequence[str]) -> str:
    """Uninstall everything that the release brought, and say what of it is left in the environment and the home."""
    home.pip("uninstall", "--yes", *names)
    found = (*home.environment.glob("bin/*"), *home.environment.glob("lib/python*/site-packages/*"))
    left = [path for path in found if path.name in PLACES or path.name.startswith("telenano")]
    if left:
        raise StumbleError(f"uninstalled, and still there: {', '.join(map(str, left))}")
    kept = sorted(str(path.relative_to(home.folder)) for path in home.folder.glob(".*/*") if "telenano" in path.name)
    return f"uninstalled, and nothing of it is left in the environment; in the home: {', '.join(kept) or 'nothing'}"


def size_of(folder: Path) -> str:
    """Return the size of a folder in words."""
    return f"{sum(path.lstat().st_size for path in folder.rglob('*')) / 1e6:.0f} MB"


def main(arguments: Sequence[str] | None = None) -> int:
    """Rehearse, print a line a step with its seconds, and return 1 with the reason where one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the folder that `make dist` leaves")
    parser.add_argument("--before", type=Path, help="the wheel of an earlier version, to upgrade from and go back to")
    given = parser.parse_args(arguments)
    begin = last = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="rehearsal-") as folder:
        try:
            for line in rehearse(Home(Path(folder)), given.folder.absolute(), given.before and given.before.absolute()):
                now = time.monotonic()
                print(f"{now - last:6.1f} s  {line}", flush=True)
                last = now
        except (StumbleError, subprocess.TimeoutExpired) as error:
            print(f"rehearsal: {error}", file=sys.stderr)
            return 1
    print(f"{time.monotonic() - begin:6.1f} s  in all, with Python {sys.version.split()[0]}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""A rig on two machines: two network namespaces joined by a cable that can be pulled."""

import contextlib
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import machine
import pytest
import yaml
from commands import COMMANDS
from following import Following, Recorded

from telenano.runtime.security.keyring import Keyring

ROOT = Path(__file__).resolve().parents[2]
TWO_SITES = ROOT / "telenano" / "settings" / "sites" / "two_sites.yaml"
MASTER, SLAVE, GUEST = "10.77.0.1", "10.77.0.2", "10.77.0.3"
HOSTS = {"master": MASTER, "slave": SLAVE}
# far beyond what is expected: it only keeps a broken rig from holding the suite
PATIENCE_S = 120.0
# a rig of its own, so that the guest's machine has a console of its own and something to listen to
_FOR_A_GUEST = {
    "haptic_node@master": {"local": "ipc://{runtime}/haptic_node@master", "network": "tcp://{master}:5701"},
    "delay_node@master": {"local": "ipc://{runtime}/delay_node@master", "network": "tcp://{master}:5703"},
    "console_guest@master": {"network": "tcp://{guest}:5707", "machine": "guest"},
}


# what a rig on two machines logs that no fault is judged by: both machines, and the tests, are this one here
NOT_NEEDED = {
    "master": ["law/*", "link/fates", "afm/*", "teleop/forward", "teleop/forward@slave", "teleop/backward"],
    "slave": ["law/*", "teleop/*"],
}

_TCP_DROPPED = """
table inet cut {{
  chain in {{ type filter hook input priority 0; iifname "{device}" meta l4proto tcp drop; }}
  chain out {{ type filter hook output priority 0; oifname "{device}" meta l4proto tcp drop; }}
}}
"""


def why_not() -> str:
    """Return why there can be no namespaces here; empty when there can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "the command `ip` (iproute2) is not installed"
    name = f"tn{secrets.token_hex(3)}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    if made.returncode:
        return f"network namespaces are not permitted here: {made.stderr.strip()}"
    subprocess.run(["ip", "netns", "del", name], check=True)
    return ""


class Cable:
    """Two namespaces and the veth pair between them; `master` and `slave` are their names."""

    def __init__(self) -> None:
        token = secrets.token_hex(3)
        self.names = {"master": f"tnm{token}", "slave": f"tns{token}"}
        for name in self.names.values():
            _ip("netns", "add", name)
        ends = {site: f"ve{site[0]}{token}" for site in self.names}
        self.ends = ends
        peer = ["peer", "name", ends["slave"], "netns", self.names["slave"]]
        _ip("link", "add", ends["master"], "netns", self.names["master"], "type", "veth", *peer)
        self.ip("master", "addr", "add", f"{MASTER}/24", "dev", ends["master"])
        for address in (SLAVE, GUEST):
            self.ip("slave", "addr", "add", f"{address}/24", "dev", ends["slave"])
        for site, end in ends.items():
            self.ip(site, "link", "set", "lo", "up")
            self.ip(site, "link", "set", end, "up")

    def ip(self, site: str, *arguments: str) -> None:
        """Run `ip` inside a namespace."""
        _ip("-n", self.names[site], *arguments)

    def inside(self, site: str, command: Sequence[str]) -> list[str]:
        """Give the command that runs another one on the machine of a site."""
        return ["ip", "netns", "exec", self.names[site], *command]

    def pull(self) -> None:
        """Pull the cable at the slave."""
        self.ip("slave", "link", "set", self.ends["slave"], "down")

    def plug(self) -> None:
        """Plug it in again."""
        self.ip("slave", "link", "set", self.ends["slave"], "up")

    def drop_tcp(self, *, dropped: bool) -> None:
        """Have a firewall at the slave drop all TCP between the sites, and nothing else, or no longer."""
        rules = _TCP_DROPPED.format(device=self.ends["slave"]) if dropped else "delete table inet cut"
        subprocess.run(self.inside("slave", ["nft", "-f", "-"]), input=rules, text=True, check=True)

    def close(self) -> None:
        """Take the namespaces away, and the cable with them."""
        for name in self.names.values():
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


class Site:
    """One machine: its keys, its folders, and the `telenano up --site` that runs there."""

    def __init__(self, name: str, cable: Cable, folder: Path, site_file: Path) -> None:
        self.name = name
        self.site_file = site_file
        self.out = folder / name
        self.keyring = Keyring(folder / f"keys-{name}")
        self.lean = False
        self.rate: Sequence[str] = machine.LOWER_RATE
        # How the nodes of this site are put into processes.
        self.processes = "node"
        self.cable = cable
        self.starts = 0
        # socket paths are short by law, pytest's folders are not
        self.sockets = Path(f"/tmp/tn-{secrets.token_hex(4)}")
        self.environment = {
            **os.environ,
            "TELENANO_RUNTIME_DIR": str(self.sockets),
            "TELENANO_KEYS_DIR": str(self.keyring.folder),
            "TELENANO_HOST_MASTER": MASTER,
            "TELENANO_HOST_SLAVE": SLAVE,
        }
        self.process: subprocess.Popen[str] | None = None
        self.log = self.out.parent / f"{name}.txt"
        self._recorded = Recorded()

    def command(self, *arguments: str) -> list[str]:
        """Give a telenano command on this machine."""
        return self.cable.inside(self.name, [sys.executable, "-m", "telenano", *arguments])

    def start(self, *arguments: str) -> None:
        """Start this site of the rig; each start has an output folder of its own."""
        self.out = self.out.parent / (self.name if not self.starts else f"{self.name}-{self.starts}")
        self.starts += 1
        common = ["up", "--site", self.name, "--site-file", str(self.site_file), "--scenario", "fig12", *self.rate]
        common += ["--set", f"realtime.processes={self.processes}"]
        if self.lean:
            common += ["--set", f"recorder.exclude={json.dumps(NOT_NEEDED[self.name])}"]
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                self.command(*common, "--out", str(self.out), "--headless", *arguments),
                env=self.environment,
                cwd=ROOT,
                stdout=log,
                stderr=log,
                text=True,
                preexec_fn=machine.usual_priority,
            )

    def telenano(self, *arguments: str, patience_s: float = 60.0) -> "subprocess.CompletedProcess[str]":
        """Run another telenano command on this machine."""
        arguments = (*arguments, "--site-file", str(self.site_file))
        return COMMANDS.run(arguments, self.environment, patience_s, self.cable.names[self.name])

    def keys_command(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Run `telenano keys` on this machine."""
        return COMMANDS.run(("keys", *arguments), self.environment, 60.0, self.cable.names[self.name])

    def python(self, text: str, *arguments: str) -> "subprocess.Popen[str]":
        """Run a Python text on this machine."""
        command = self.cable.inside(self.name, [sys.executable, "-c", text, *arguments])
        return subprocess.Popen(
            command,
            env=self.environment,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=machine.usual_priority,
        )

    def has_log(self, node: str, text: str, times: int = 1) -> bool:
        """Return whether a node of this site has written a text so many times."""
        path = self.out / "logs" / f"{node}.log"
        if not path.exists():
            # Nodes that share a process share its log.
            path = path.with_name(f"site@{self.name}.log")
        return path.exists() and path.read_text().count(text) >= times

    def logs(self) -> str:
        """Give what was printed at this machine last, for a failed test."""
        tails = [self.log] if self.log.exists() else []
        tails += sorted((self.out / "logs").glob("*.log"))
        return "\n".join(f"== {path}\n{path.read_text()[-1500:]}" for path in tails)

    def recording(self) -> Following:
        """Give what this site's recorder has written since its last start, up to now."""
        return self._recorded.newest(self.out)

    def summary(self) -> dict[str, Any]:
        """Give the summary that the master's site made."""
        found: dict[str, Any] = json.loads((self.out / "summary.json").read_text())
        return found

    def stop(self, number: int = signal.SIGINT) -> int:
        """End the site's launcher and wait for it."""
        assert self.process is not None
        if self.process.poll() is None:
            # the process is `ip netns exec`, which has become the launcher
            self.process.send_signal(number)
        return self.process.wait(timeout=PATIENCE_S)

    def close(self) -> None:
        """Take down what still runs and leave no socket behind."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout=30)
            self.process.kill()
            self.process.wait()
        shutil.rmtree(self.sockets, ignore_errors=True)


class TwoSites:
    """Both machines, with keys that know each other, and a third that may only look on."""

    def __init__(
        self, folder: Path, *, insecure: bool = False, guest: bool = False, cable: Cable | None = None, **link: object
    ) -> None:
        self.folder = folder
        self.cable = cable or Cable()
        document = yaml.safe_load(TWO_SITES.read_text())
        document["insecure"] = insecure
        document["link"] = {**document.get("link", {}), **link}
        if guest:
            document["machines"]["guest"] = GUEST
            document["nodes"].update(_FOR_A_GUEST)
        site_file = folder / "two_sites.yaml"
        site_file.write_text(yaml.safe_dump(document))
        self.master = Site("master", self.cable, folder, site_file)
        self.slave = Site("slave", self.cable, folder, site_file)
        self.guest = Keyring(folder / "keys-guest")
        keys = {site.name: site.keyring.create(site.name).public.decode() for site in (self.master, self.slave)}
        self.keys = {**keys, "guest": self.guest.create("guest").public.decode()}
        self.master.keyring.allow("slave", keys["slave"], ["data"])
        self.slave.keyring.allow("master", keys["master"], ["data", "control"])
        for name, roles in (("master", ["data", "control"]), ("slave", ["data"])):
            self.guest.allow(name, keys[name], roles)
        if guest:
            for site in (self.master, self.slave):
                site.keyring.allow("guest", self.keys["guest"], ["observe"])

    def guest_command(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Run a telenano command on the guest's machine, which shares the slave's end of the cable."""
        environment = {**self.slave.environment, "TELENANO_KEYS_DIR": str(self.guest.folder)}
        environment |= {"TELENANO_MACHINE": "guest", "TELENANO_RUNTIME_DIR": str(self.slave.sockets) + "g"}
        arguments = (*arguments, "--site-file", str(self.slave.site_file))
        return COMMANDS.run(arguments, environment, 60.0, self.cable.names["slave"])

    def wait_until(self, condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> float:
        """Wait for a condition and give the time that it took [s]."""
        begin = time.monotonic()
        while time.monotonic() < begin + patience_s:
            if condition():
                return time.monotonic() - begin
            time.sleep(0.2)
        raise AssertionError(f"waited in vain for: {what}\n{self.master.logs()}\n{self.slave.logs()}")

    def running(self) -> bool:
        """The operator's force profile has been started."""
        return self.master.has_log("launcher@master", "the session is running")

    def start(self, *arguments: str) -> None:
        """Start both sites and wait for the session."""
        self.slave.start()
        self.master.start(*arguments)
        self.wait_until(self.running, "a running session")

    def end_session(self) -> dict[str, Any]:
        """End the session as an operator does, with the slave's recording fetched, and give its summary.

        It has a verdict of what both sites recorded, whatever befell them.
        """
        self.master.stop()
        assert "was not fetched" not in self.master.log.read_text(), self.master.logs()
        summary = self.master.summary()
        assert Path(summary["recording"]["file"]).name == "both.mcap", summary["recording"]
        assert summary["verdict"] != "no_data", summary["reason"]
        return summary

    def rearm(self) -> None:
        """Take the rig up again as the operator would, after the tip was withdrawn."""
        for device in ("afm_node", "haptic_node"):
            self.wait_until(
                lambda target=device: self.master.telenano("session", "arm", "--target", target).returncode == 0,
                f"an armed {device}",
            )

    def close(self) -> None:
        """Take everything down."""
        for site in (self.master, self.slave):
            site.close()
        self.cable.close()


needs_namespaces = pytest.mark.skipif(bool(why_not()), reason=why_not() or "there are namespaces")

SNIFFER = """
import socket, sys, time
end = time.monotonic() + float(sys.argv[2])
wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
wire.bind((sys.argv[1], 0))
wire.settimeout(0.2)
print("listening", flush=True)
with open(sys.argv[3], "wb") as out:
    while time.monotonic() < end:
        try:
            out.write(wire.recv(65535))
        except TimeoutError:
            pass
"""


def sniff(site: Site, duration_s: float, path: Path) -> bytes:
    """Give every byte that crosses the cable at a site in a time [s]."""
    sniffer = site.python(SNIFFER, site.cable.ends[site.name], str(duration_s), str(path))
    assert sniffer.stdout is not None
    assert sniffer.stdout.readline() == "listening\n"
    assert sniffer.wait(timeout=duration_s + 30) == 0
    sniffer.stdout.close()
    return path.read_bytes()


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, f"ip {' '.join(arguments)}: {done.stderr}"

"""A rig on two machines that can only dial out: each behind a router with address translation, a relay between them."""

import os
import secrets
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

import machine
import yaml
from two_sites import ROOT, Cable, Site, TwoSites, _ip

from telenano.runtime.security.keyring import Keyring

PORT = 5750
# documentation addresses: the routers' outside, and the relay's on each side
OUTSIDE = {"master": "198.51.100.1", "slave": "203.0.113.1"}
RELAY = {"master": "198.51.100.2", "slave": "203.0.113.2"}
INSIDE = {"master": "10.81.1", "slave": "10.82.1"}
# A router keeps the port of what it translates, as most do, or takes another for each address, which no try gets past.
_ROUTER = """
table ip nat {{
  chain post {{
    type nat hook postrouting priority 100;
    oifname "wan" masquerade{how};
  }}
}}
table ip filter {{
  chain in {{
    type filter hook input priority 0;
    iifname "wan" ct state established,related accept;
    iifname "wan" drop;
  }}
  chain forward {{
    type filter hook forward priority 0;
    iifname "wan" ct state established,related accept;
    iifname "wan" drop;
  }}
}}
"""


class RoutedCable(Cable):
    """Two sites, each behind a router of its own, and the machine of the relay between the routers.

    `beside` is the cable of another rig, whose relay serves this one as well.
    """

    def __init__(self, *, strict: bool = False, beside: "RoutedCable | None" = None) -> None:
        token = secrets.token_hex(3)
        self.number = 0 if beside is None else beside.number + 1
        outside, self.relay = OUTSIDE, RELAY
        if self.number:
            # networks for measurements between machines (RFC 2544)
            nets = {site: f"198.{18 + place}.{self.number}" for place, site in enumerate(OUTSIDE)}
            outside, self.relay = ({site: f"{net}.{end}" for site, net in nets.items()} for end in (1, 2))
        self.names = {"master": f"tnm{token}", "slave": f"tns{token}"}
        self.routers = {site: f"tn{site[0]}g{token}" for site in OUTSIDE}
        # These namespaces are removed with this cable.
        self.own = [*self.names.values(), *self.routers.values()]
        if beside is None:
            self.own.append(f"tnr{token}")
        self.names["relay"] = self.own[-1] if beside is None else beside.names["relay"]
        for name in self.own:
            _ip("netns", "add", name)
            _ip("-n", name, "link", "set", "lo", "up")
        self.ends = dict.fromkeys(OUTSIDE, "lan")
        for site, router in self.routers.items():
            _wire(self.names[site], "lan", router, "lan")
            _wire(router, "wan", self.names["relay"], f"to_{site}{self.number}")
            for name, device, address in (
                (self.names[site], "lan", f"{INSIDE[site]}.2/24"),
                (router, "lan", f"{INSIDE[site]}.1/24"),
                (router, "wan", f"{outside[site]}/24"),
                (self.names["relay"], f"to_{site}{self.number}", f"{self.relay[site]}/24"),
            ):
                _ip("-n", name, "addr", "add", address, "dev", device)
                _ip("-n", name, "link", "set", device, "up")
            _ip("-n", self.names[site], "route", "add", "default", "via", f"{INSIDE[site]}.1")
            _ip("-n", router, "route", "add", "default", "via", self.relay[site])
            rules = _ROUTER.format(how=" fully-random" if strict else "")
            subprocess.run(["ip", "netns", "exec", router, "nft", "-f", "-"], input=rules, text=True, check=True)
        for name in (*self.routers.values(), self.names["relay"]):
            subprocess.run(
                ["ip", "netns", "exec", name, "sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward"], check=True
            )

    def close(self) -> None:
        for name in self.own:
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


def _wire(one: str, device: str, other: str, other_device: str) -> None:
    _ip("-n", one, "link", "add", device, "type", "veth", "peer", "name", other_device, "netns", other)


class RelayedSites(TwoSites):
    """Both machines, and the relay, which lists their keys and knows nothing else.

    `beside` is another rig, whose relay serves this one as well.
    """

    def __init__(
        self, folder: Path, *, strict: bool = False, beside: "RelayedSites | None" = None, **link: object
    ) -> None:
        self.cable: RoutedCable
        super().__init__(folder, cable=RoutedCable(strict=strict, beside=beside and beside.cable), **link)
        self.relay_keys = beside.relay_keys if beside else Keyring(folder / "keys-relay")
        self.relay_public = beside.relay_public if beside else self.relay_keys.create("relay").public.decode()
        for site in self.sites:
            document = yaml.safe_load(site.site_file.read_text())
            # The relay has an address on the side of each site here; elsewhere it has one.
            document["relay"] = f"{self.cable.relay[site.name]}:{PORT}"
            site.site_file = folder / f"{site.name}.yaml"
            site.site_file.write_text(yaml.safe_dump(document))
            site.keyring.allow("relay", self.relay_public, ["relay"])
            self.relay_keys.allow(f"lab_{site.name}_{self.cable.number}", self.keys[site.name], ["relay"])
        self.relay: subprocess.Popen[str] | None = None
        self.relay_log = folder / "relay.txt"

    @property
    def sites(self) -> tuple[Site, Site]:
        return self.master, self.slave

    def start_relay(self, *command: str) -> None:
        """Start the relay, or another program in its place."""
        arguments = command or ("-m", "telenano", "relay", "--listen", f"0.0.0.0:{PORT}")
        with self.relay_log.open("a") as log:
            self.relay = self._spawn([sys.executable, *arguments], log)
        self.wait_until(lambda: "listening" in self.relay_log.read_text(), "a relay", 30.0)

    def _spawn(self, command: list[str], log: IO[str]) -> "subprocess.Popen[str]":
        environment = {**os.environ, "TELENANO_KEYS_DIR": str(self.relay_keys.folder)}
        return subprocess.Popen(
            self.cable.inside("relay", command),
            env=environment,
            cwd=ROOT,
            stdout=log,
            stderr=log,
            text=True,
            preexec_fn=machine.usual_priority,
        )

    def stop_relay(self, number: int = signal.SIGKILL) -> None:
        """End the relay."""
        if self.relay is not None:
            self.relay.send_signal(number)
            self.relay.wait(timeout=30.0)
            self.relay = None

    def close(self) -> None:
        self.stop_relay()
        super().close()

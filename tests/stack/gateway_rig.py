"""A gateway and the end of a rig as processes of their own, beside the server of a page without a rig."""

import os
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser_page import until
from page_without_rig import SaidRig, served

from telenano.runtime.security.keyring import Keyring
from telenano.testing import free_ports

RIG = "lab_a"


class GatewayRig:
    """The processes; `address` is that of the rig's page at the gateway, without a token, `rig` what the page moves."""

    def __init__(self, folder: Path, rig: SaidRig, page: str) -> None:
        self.rig = rig
        self._folder = folder
        self._port, self._relay_port = free_ports(2)
        self.address = f"https://127.0.0.1:{self._port}/{RIG}/"
        self._page_port = page.rstrip("/").rpartition(":")[2]
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        rings = {name: Keyring(folder / name) for name in ("relay", "master")}
        keys = {name: ring.create(name).public.decode() for name, ring in rings.items()}
        rings["relay"].allow(RIG, keys["master"], ["relay"])
        rings["master"].allow("relay", keys["relay"], ["relay"])

    def start_gateway(self) -> None:
        words = ["--name", "127.0.0.1", "--port", str(self._port), "--host", "127.0.0.1"]
        self._start("relay", *words, "--listen", f"127.0.0.1:{self._relay_port}")
        self._wait("relay", "pages are at", "a gateway that serves")

    def start_end(self) -> None:
        self._start("master", "--join", f"127.0.0.1:{self._relay_port}", "--page-port", self._page_port)
        self._wait("master", "is reached", "a rig at the gateway")

    def kill(self, name: str) -> None:
        """End a process as a crash does: `relay` is the gateway, `master` the end of the rig."""
        process = self._running.pop(name)
        process.kill()
        process.wait()

    def close(self) -> None:
        for name in list(self._running):
            self.kill(name)

    @property
    def bus(self) -> str:
        """The address of the page's socket at the gateway."""
        return f"wss{self.address.removeprefix('https')}bus"

    @property
    def origin(self) -> Any:
        return self.address.removesuffix(f"/{RIG}/")

    def _wait(self, name: str, text: str, what: str) -> None:
        """Wait until a process that was started has logged a text."""

        def is_said() -> bool:
            log = (self._folder / f"{name}.log").read_text()
            assert self._running[name].poll() is None, log
            return text in log

        until(is_said, what)

    def _start(self, name: str, *words: str) -> None:
        environment = {**os.environ, "TELENANO_KEYS_DIR": str(self._folder / name)}
        with (self._folder / f"{name}.log").open("wb") as log:
            command = [sys.executable, "-m", "telenano", "gateway", *words]
            self._running[name] = subprocess.Popen(command, env=environment, stdout=log, stderr=log)


@contextmanager
def behind_gateway(folder: Path) -> Iterator[GatewayRig]:
    """Serve the page of a rig that is said, behind a gateway to which it has dialled out."""
    with served(SaidRig()) as (rig, page):
        found = GatewayRig(folder, rig, page)
        try:
            found.start_gateway()
            found.start_end()
            yield found
        finally:
            found.close()


def unverified() -> ssl.SSLContext:
    """Return a context that takes the certificate which a gateway has made by itself."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context

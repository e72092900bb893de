"""Emulated AFM controllers with their guards, as processes of their own: what the live tests drive and break."""

import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml
from stack_rig import ROOT
from telenano_devices.controllers.request_answer import Incoming
from telenano_devices.gwyscope import gwyscope_wire
from telenano_devices.nanonis.nanonis_client import NanonisClient

from telenano.testing import free_ports

PATIENCE_S = 60.0


class Emulated:
    """An emulated controller and its guard, and what a rig needs to use them."""

    name = ""

    def __init__(self, folder: Path, scenario: str, *options: str) -> None:
        self.file = folder / f"{self.name}.yaml"
        self.port, self.guard_port = free_ports(2)
        known = f"telenano/settings/scenarios/{scenario}.yaml"
        chosen = known if (ROOT / known).exists() else scenario
        served = ("--port", str(self.port), *options, "--scenario", chosen)
        self.server = self._start("simulate", *served, "--calibration", str(self.file))
        self._wait(self.port)
        document = yaml.safe_load(self.file.read_text())
        document["network"]["port"] = self.guard_port
        # a machine that is shared holds processes up for the 50 ms of the default
        document["heartbeat_s"] = 0.2
        self.file.write_text(yaml.safe_dump(document))
        to = ("--controller", f"127.0.0.1:{self.port}", "--port", str(self.guard_port))
        self.guard = self._start("guard", "--calibration", str(self.file), *to)
        self._wait(self.guard_port)

    def _start(self, what: str, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "telenano", "device", what, self.name, *arguments]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)

    def _wait(self, port: int) -> None:
        end = time.monotonic() + PATIENCE_S
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    return
            assert time.monotonic() < end, f"no process listens at {port}"
            time.sleep(0.05)

    @property
    def options(self) -> list[str]:
        settings = {"afm_node.driver": self.name, f"afm_node.{self.name}.calibration": self.file}
        return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]

    @property
    def z_m(self) -> float:
        raise NotImplementedError

    def close(self) -> None:
        for process in (self.guard, self.server):
            process.kill()
            process.wait()


class Gwyscope(Emulated):
    """A Gwyscope, which other programs may ask as well."""

    name = "gwyscope"

    def __init__(self, folder: Path, scenario: str) -> None:
        super().__init__(folder, scenario)
        self._line = socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)
        self._incoming = Incoming(gwyscope_wire.cut)

    def ask(self, **message: Any) -> dict[str, Any]:
        """Ask the server itself, as another program would."""
        self._line.sendall(gwyscope_wire.encode(message))
        while (answer := self._incoming.take()) is None:
            self._incoming.add(self._line.recv(65536))
        return gwyscope_wire.decode(answer)

    @property
    def z_m(self) -> float:
        return float(self.ask(todo="read")["z"])

    def close(self) -> None:
        self._line.close()
        super().close()


class Nanonis(Emulated):
    """A Nanonis controller; the vendor's software, and this test, are at another of its ports."""

    name = "nanonis"

    def __init__(self, folder: Path, scenario: str, *options: str) -> None:
        super().__init__(folder, scenario, "--log-port", *map(str, free_ports(1)), *options)
        self.client = NanonisClient("127.0.0.1", self.port + 1)

    @property
    def z_m(self) -> float:
        return float(self.client.call("ZCtrl.ZPosGet")[0])

    def close(self) -> None:
        self.client.close()
        super().close()

"""An AFM controller of somebody else: one folder with an entry point, and no line of the core."""

from typing import Any

import pytest

from telenano.testing import install_package, said_with

# A controller of lines: `z METRES` is answered with z and the deflection's signal.
PACKAGE = """
from pathlib import Path
from typing import Literal
from telenano.settings import DeviceDriver
from telenano.devices import AfmCapabilities
from telenano.sections import AfmControllerConfig as ControllerSettings
from telenano_devices.controllers.piezo_calibration import ControllerCalibration
from telenano_devices.controllers.request_driver import RequestDriver

class Calibration(ControllerCalibration):
    controller: Literal["line_afm"]

def cut(stream):
    return stream.find(b"\\n") + 1

class LineAfm(RequestDriver[Calibration]):
    latency_s = 5e-3

    def talk(self):
        if not self._attended:
            self.refuse_without_guard()
        begun = False
        while True:
            asked_ns = self._now_ns()
            z_m, value = map(float, (yield b"z %g\\n" % self.wanted_z_m()).split())
            if not begun:
                self.begin_cycles("a controller of lines")
            begun = True
            self.take_sample(z_m, value, asked_ns)

def build(settings, limits, **told):
    found = Calibration.from_file(Path(settings.calibration)).reached_at(settings.host, settings.port)
    return LineAfm(found, limits, cut, "controller of lines", **told)

LINE_AFM = DeviceDriver(
    "afm_node", "line_afm", ControllerSettings, build, keywords=("period_s", "attended"), calibration=Calibration,
    capabilities=AfmCapabilities(100.0, 100.0, 5e-3, False, False, True, ("deflection",), "the guard"),
)
"""

PROGRAM = """
import asyncio, json, socket, sys, threading
from datetime import UTC, datetime
from pathlib import Path
import yaml
from typer.testing import CliRunner
from telenano.launcher.plan import UpRequest, make_plan
from telenano.wire.errors import ConfigError
from telenano.cli.root import app
from telenano.doctor.devices import check_instrument
from telenano_devices.controllers.request_server import serve_requests

assert "telenano_line_afm" not in sys.modules
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
file = Path(sys.argv[1]) / "line.yaml"
file.write_text(yaml.safe_dump({
    "schema": 1, "controller": "line_afm", "calibrated": datetime(2026, 1, 1, tzinfo=UTC),
    "network": {"host": "127.0.0.1", "port": port},
    "z": {"towards_sample": 1, "rest_m": 1e-6, "retract_m": 0.0, "min_m": 0.0, "max_m": 2e-6},
    "deflection": {"signal": "d", "zero": 0.0, "per_m": 1e6, "limit": 10.0},
    "cantilever": {"stiffness_n_per_m": 40.0},
}))
found = {}

def planned(**changes):
    settings = ("afm_node.driver=line_afm", f"afm_node.line_afm={{calibration: {file}}}", "controller.law=wave")
    try:
        return make_plan(UpRequest(scenario="fig12", settings=settings, **changes), Path(sys.argv[1])).scenario.name
    except ConfigError as error:
        return str(error)

found["plan"] = planned()
ready = threading.Event()
from telenano_line_afm import cut

def respond(request, now_ns):
    return request.split()[1] + b" 0.25\\n"

def serve():
    asyncio.run(serve_requests(cut, respond, lambda now_ns: None, "127.0.0.1", [port], ready.set))

threading.Thread(target=serve, daemon=True).start()
assert ready.wait(30.0)
done = CliRunner().invoke(app, ["device", "probe", "--calibration", str(file), "--json"])
found["probe"] = json.loads(done.stdout)
found["doctor"] = list(check_instrument(file))
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("line")
    entries = {"devices": {"line_afm": "telenano_line_afm:LINE_AFM"}}
    install_package(folder, "telenano_line_afm", {"__init__.py": PACKAGE}, entries)
    answers: dict[str, Any] = said_with(PROGRAM, folder, str(folder))
    return answers


@pytest.mark.check("an interpreter of its own")
def test_what_it_cannot_do_is_refused_before_anything_starts(found: dict[str, Any]) -> None:
    assert "wave closes a loop through the instrument, and line_afm gives 100 samples a second" in found["plan"]


@pytest.mark.check("makes a package and starts an interpreter of its own")
def test_its_calibration_file_is_enough_to_probe_it_and_to_look_for_it(found: dict[str, Any]) -> None:
    probe = found["probe"]
    assert probe["identity"] == "a controller of lines"
    assert (probe["base_m"], probe["input_v"], probe["declared_latency_s"]) == (-1e-6, 0.25, 5e-3)
    assert probe["force_n"] == pytest.approx(1e-5, rel=1e-9, abs=0.0)
    assert found["doctor"][:2] == ["instrument", "ok"]

"""`telenano device` against an emulated handle, in this process, and what it says of what is not there."""

import json
import shutil
import threading
import time
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from services.afm_node.config import AfmConfig
from services.afm_node.devices.t7_model import calibration_of
from services.haptic_node.config import HapticConfig
from telenano.cli import root
from telenano.cli.commands.device import app
from telenano.cli.commands.device_files import section_of

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt install gcc libc6-dev")


@needs_compiler
def test_probe_tells_who_a_handle_is(tmp_path: Path) -> None:
    from services.haptic_node.devices.emulated_handle import EmulatedHandle
    from services.haptic_node.devices.handle_on_pty import HandleOnPty

    port = HandleOnPty(EmulatedHandle(HapticConfig(), session=7), tmp_path / "handle")
    running = threading.Event()
    running.set()
    thread = threading.Thread(target=lambda: port.run(running.is_set))
    thread.start()
    try:
        until = time.monotonic() + 120.0
        done = CliRunner().invoke(app, ["probe", "--port", str(tmp_path / "handle"), "--json"])
        # a machine that is busy may hold the board up for longer than the three seconds of the handshake
        while done.exit_code and time.monotonic() < until:
            done = CliRunner().invoke(app, ["probe", "--port", str(tmp_path / "handle"), "--json"])
    finally:
        running.clear()
        thread.join()
        port.pull_out()
    found = json.loads(done.stdout)
    assert (found["device_id"], found["protocol"], found["firmware"]) == ("0102030405060708", "1.0", "1.0")
    assert found["abilities"] == "position mode, force sensor, current is sensed, emulated"


def test_what_is_not_there_is_a_sentence_and_exit_code_2(tmp_path: Path) -> None:
    missing = CliRunner().invoke(app, ["probe", "--port", str(tmp_path / "none")])
    assert missing.exit_code == 2
    assert "there is no such port" in missing.output
    neither = CliRunner().invoke(app, ["probe"])
    assert neither.exit_code == 2
    assert "--port for a handle, or --calibration for an instrument" in neither.output
    # a port that nothing listens at: the connection is refused at once
    stage = tmp_path / "stage.yaml"
    stage.write_text(yaml.safe_dump(calibration_of(6.25e6, 40.0, port=1)))
    silent = CliRunner().invoke(app, ["probe", "--calibration", str(stage)])
    assert silent.exit_code == 2
    assert "127.0.0.1:1: LabJack T7" in silent.output


@pytest.mark.parametrize("emulator", ["haply", "handle", "t7", "gwyscope", "nanonis"])
def test_emulators_take_a_scenario_by_its_name_and_say_which_there_are(emulator: str) -> None:
    done = CliRunner().invoke(root.app, ["device", "simulate", emulator, "--scenario", "fig13"])
    assert done.exit_code == 2
    assert "unknown scenario 'fig13': known are" in done.output and "fig12" in done.output


def test_scenario_of_an_emulator_is_a_name_a_file_or_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        yaml.safe_dump(
            {"name": "mine", "description": "mine", "duration_s": 1.0, "afm_node": {"rest_distance_m": 2.0e-8}}
        )
    )
    found = [section_of(given, "afm_node", AfmConfig).rest_distance_m for given in (Path("fig12"), file)]
    assert found == [1.0e-8, 2.0e-8]
    assert section_of(None, "afm_node", AfmConfig) == AfmConfig()

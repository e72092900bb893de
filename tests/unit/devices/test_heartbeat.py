"""The heartbeat script of a T7: loaded and checked by the driver, and the tip retracts when its host dies."""

import random
import shutil
import subprocess
from typing import Any

import pytest
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.register_message import WriteMultipleRegistersRequest, WriteMultipleRegistersResponse
from telenano_devices.t7.stage_line import PARAMS, StageLine, calibration
from telenano_devices.t7.t7_model import HeartbeatScript, T7Model

from services.afm_node.node import AfmNode
from telenano.devices.afm.register_map import MAPS, RegisterMap, read_map
from telenano.extend.instruments import DeviceError
from telenano.sections.afm_section import AfmConfig
from telenano.settings.config import validate
from telenano.wire.errors import ConfigError

SCRIPT = MAPS / "t7_heartbeat.lua"
BEAT, LIMIT_MS, SAFE_V, OUTPUT, RUNNING, TRIPS = range(46000, 46012, 2)
LUA_RUN = 6000
# the registers and the interval of the device; a step of the host comes before each step of the script
STUB = """
local ram, steps = {}, {%s}
local at = 0
MB = {R = function(address) return ram[address] or 0 end, W = function(address, kind, value) ram[address] = value end}
ram[46002], ram[46004], ram[46006] = 50, 0.25, 1000
LJ = {IntervalConfig = function(handle, ms) assert(handle == 0 and ms == 5) end}
LJ.CheckInterval = function()
  if at > 0 then print(ram[1000], ram[46010] or 0, ram[46008] or 0) end
  at = at + 1
  if at > #steps then error("end") end
  ram[46000], ram[1000] = steps[at], 2.5
  return 1
end
local ok, why = pcall(dofile, "%s")
assert(not ok and why:match("end$"), why)
"""


@pytest.fixture
def line() -> StageLine:
    found = StageLine()
    found.driver.open()
    return found


def approach(line: StageLine) -> None:
    """Let the driver retract and then hold the base at rest, as a node does that is armed."""
    line.follow(PARAMS.safety.retract_position_m, 3)
    line.follow(0.0, 200)
    assert line.model.output_v == pytest.approx(2.5, abs=2e-3)


def test_script_does_on_the_device_what_the_model_of_it_does() -> None:
    lua = shutil.which("lua5.1")
    if lua is None:
        pytest.skip("needs Lua 5.1: apt install lua5.1")
    source = random.Random(7)
    beats, beat = [], 0
    while len(beats) < 400:
        beat = source.choice([0, beat + 1, beat + 1])
        # some stand still for longer than the limit of ten steps
        beats += [beat] * source.choice([1, 1, 2, 9, 11, 12, 20])
    stub = STUB % (", ".join(map(str, beats)), SCRIPT)
    done = subprocess.run([lua, "-"], input=stub, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = [tuple(map(float, row.split())) for row in done.stdout.splitlines()]
    line = StageLine()
    model, script = line.model, line.model.script
    for address, value in ((LIMIT_MS, 50.0), (SAFE_V, 0.25), (OUTPUT, 1000.0)):
        model.set_value(address, value)
    script.load(SCRIPT.read_bytes())
    model.set_value(6012, float(len(SCRIPT.read_bytes())))
    script.control(LUA_RUN, 1.0, 0)
    expected = []
    for number, value in enumerate(beats, start=1):
        model.set_value(BEAT, float(value))
        model.set_value(1000, 2.5)
        script.pass_time(number * 5_000_000)
        expected.append((model.output_v, model.value(TRIPS), model.value(RUNNING)))
    assert max(row[1] for row in expected) > 3.0
    for row, same in zip(found, expected, strict=True):
        assert row == pytest.approx(same, abs=2e-3)


def test_script_is_loaded_once_and_kept(line: StageLine) -> None:
    assert line.model.script.runs
    assert line.model.script.saved.rstrip() == SCRIPT.read_bytes().rstrip()
    written = line.model.flash_writes
    line.driver.close()
    line.driver.open()
    assert line.model.flash_writes == written


@pytest.mark.parametrize(("heartbeat_s", "at_most_s"), [(0.05, 0.1), (0.2, 0.4), (0.0, 1.1)])
def test_host_that_is_killed_leaves_the_tip_retracted(heartbeat_s: float, at_most_s: float) -> None:
    line = StageLine(calibration(heartbeat_s=heartbeat_s))
    line.driver.open()
    approach(line)
    # no request comes any more
    silent_ms = 0
    while line.model.output_v > 2e-3:
        line.pass_ms(1)
        silent_ms += 1
        assert silent_ms < 3000
    assert (heartbeat_s or 1.0) * 1e3 <= silent_ms <= at_most_s * 1e3


def test_process_that_was_held_up_does_not_go_back_to_the_sample(line: StageLine) -> None:
    approach(line)
    line.pass_ms(43)
    assert line.model.output_v > 2.0
    line.driver.exchange(0.0)
    assert line.driver.report.status == "lost"
    assert "had no request for 4" in line.driver.report.text
    seen_v = []
    for _ in range(1500):
        line.follow(0.0, 1)
        seen_v.append(line.model.output_v)
    assert line.driver.report.status == "ok"
    assert max(seen_v[60:]) < 2e-3
    # the guard has it there as well, and was armed
    approach(line)


def test_pause_of_a_host_whose_tip_is_retracted_is_no_loss(line: StageLine) -> None:
    line.follow(PARAMS.safety.retract_position_m, 100)
    retracted_v = line.model.output_v
    # as between the opening of the device and the first turn of the loop
    line.pass_ms(200)
    line.follow(PARAMS.safety.retract_position_m, 5)
    assert line.driver.report.status == "ok"
    assert line.model.value(TRIPS) == 0.0
    assert line.model.output_v == retracted_v
    # and from the first step towards the sample on the script watches
    line.follow(PARAMS.safety.retract_position_m + 20e-9, 100)
    assert line.model.output_v > retracted_v + 0.2
    line.pass_ms(60)
    assert line.model.output_v == 0.0


def test_beat_that_got_lost_on_the_way_is_a_loss_although_the_device_answers(line: StageLine) -> None:
    approach(line)
    for _ in range(80):
        # as if the script had seen none of them
        line.model.set_value(BEAT, 1.0)
        line.model.script.pass_time(line.now_ns)
        line.follow(0.0, 1)
        line.model.set_value(BEAT, 1.0)
        if line.driver.report.status == "lost":
            break
    assert line.driver.report.status == "lost"
    assert "its script has retracted the stage" in line.driver.report.text
    assert line.model.value(TRIPS) >= 1.0


def test_script_that_does_not_run_is_a_sentence_and_nothing_is_driven() -> None:
    line = StageLine()
    usual = line.respond

    def without_lua(request: ModbusPDU) -> ModbusPDU:
        if isinstance(request, WriteMultipleRegistersRequest) and request.address == LUA_RUN:
            return WriteMultipleRegistersResponse(address=request.address, count=len(request.registers))
        return usual(request)

    line.respond = without_lua
    with pytest.raises(DeviceError, match=r"t7_heartbeat.lua was loaded and does not run; .* heartbeat_s: 0"):
        line.driver.open()
    assert line.model.output_v == 0.0


def test_another_script_that_runs_is_replaced(line: StageLine) -> None:
    line.driver.close()
    model: T7Model = line.model
    model.script = HeartbeatScript(model)
    other = b"-- telenano heartbeat\nlocal VERSION = 7\n"
    model.script.load(other)
    model.set_value(6012, float(len(other)))
    model.script.control(LUA_RUN, 1.0, line.now_ns)
    line.pass_ms(10)
    assert model.value(RUNNING) == 7.0
    line.driver.open()
    assert model.value(RUNNING) == 1.0


def test_heartbeat_that_is_too_short_or_goes_with_no_request_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"heartbeat_s = 0.01 s must be 0 \(none\) or 0.02 s and more"):
        calibration(heartbeat_s=0.01)
    document = read_map("t7").model_dump(mode="json", by_alias=True, exclude_none=True)
    with pytest.raises(ConfigError, match="a heartbeat goes with every request: exchange must be feedback"):
        validate(RegisterMap, {**document, "exchange": "write_then_read"}, "t7.yaml")


def test_retraction_is_confirmed_by_the_output_read_back(line: StageLine) -> None:
    approach(line)
    assert line.driver.retract() is True
    assert line.model.output_v == 0.0
    approach(line)
    # the connection is gone for a moment: a new one retracts
    line.driver._line = None
    line.driver._drop(line.now_ns)
    assert line.driver.retract() is True
    assert line.model.output_v == 0.0
    line.reachable = False
    assert line.driver.retract() is False


@pytest.mark.parametrize("reachable", [True, False])
def test_node_says_when_its_last_retraction_is_not_confirmed(bench_of: Any, reachable: bool) -> None:
    bench, line = bench_of("afm_node@slave"), StageLine()
    node = AfmNode(bench.context, AfmConfig(), line.driver)
    line.reachable = reachable
    node.make_safe()
    texts = [event.text for event in bench.take("session/event")]
    assert any("was not confirmed" in text for text in texts) is not reachable

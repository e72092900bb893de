"""`telenano device trial`: each emulator whole, each of its faults found on the page, and what the file has in it."""

import gc
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

if shutil.which("cc") is None:
    pytest.skip("the emulated handle and doubles of vendors' libraries need a C compiler", allow_module_level=True)

import test_haptic_acceptance as simulated
import test_instrument_acceptance as instruments
from telenano_devices.acceptance.handle.take import facts_of, record_take
from telenano_devices.acceptance.haptic_device import devices, simulated_link
from telenano_devices.acceptance.haptic_device.devices import make_take
from telenano_devices.acceptance.haptic_device.take import Facts
from telenano_devices.acceptance.haptic_device.take import record_take as record_haptic_take
from telenano_devices.acceptance.instrument.instruments import facts_of as facts_of_instrument
from telenano_devices.acceptance.instrument.take import record_take as record_instrument_take
from telenano_devices.acceptance.take import SILENT, Clock, EndedError, Guide, Step
from telenano_devices.acceptance.trial.devices import TriedDevice
from telenano_devices.acceptance.trial.sheet import judged_again, sheet_of
from telenano_devices.acceptance.trial.trial_command import make_trial
from telenano_devices.acceptance.trial.trial_file import Trial, read_trial, write_trial
from telenano_devices.doubles import live_devices
from telenano_devices.handle.handle_line import HandleLine, calibration
from telenano_devices.haply import haply_service
from telenano_devices.impedance.impedance_config import CouplingConfig
from test_acceptance_wires import MASS_KG, STEPS, SWINGS, TakeBench, Wrong

from telenano.cli import run_ahead
from telenano.sections import HapticConfig
from telenano.testing import invoke, options_of
from telenano.wire import ConfigError

check = pytest.mark.check("makes a whole trial of an emulated device")
Put = Callable[[str], None]


def nothing(step: str) -> None:
    """Put no fault in."""


def page_of(trial: Trial, folder: Path) -> dict[str, tuple[str, str]]:
    """Return result and reason of each line of the page that the file of a trial gives, by its check."""
    path = folder / "trial.zip"
    write_trial(path, trial)
    page = sheet_of(read_trial(path))
    assert page == sheet_of(trial) and judged_again(read_trial(path)) == []
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    return {row[0]: (row[1], row[2]) for row in rows if row[0] != "check"}


# --- devices that take a force: the emulated Inverse Service, and the doubles of two vendors' libraries


class TrialBench(TakeBench):
    """A trial over the wire of a driver, with something that is done as a step begins."""

    put: Put = staticmethod(nothing)

    def _record(self) -> Any:
        settings = self.coupling.to_settings(self.capabilities)
        facts = Facts(self.capabilities, settings, MASS_KG, "foot switch")

        def record(guide: Guide) -> Any:
            return record_haptic_take(self, facts, STEPS, Clock(self.time.now_ns, self._wait), guide)

        try:
            return make_trial(self.device.kind, TriedDevice(record, ()), Guide(lambda step: self.put(step.name)))
        finally:
            self._ended = True
            self._to_servo.release()


def wire_trial(kind: str, folder: Path, put: Callable[[Any], Put], stiffness: float | None = None) -> Trial:
    bench = TrialBench(kind, folder, {}, Wrong({}))
    bench.coupling = CouplingConfig(stiffness_n_per_m=stiffness)
    bench.put = put(bench)
    found: Any = bench.take()
    assert isinstance(found, Trial)
    return found


def at(step: str, act: Callable[[], object]) -> Put:
    return lambda begun: (begun == step and act()) and None


# By the words of the emulator: in which step it is said to it, as what, and the check that finds it.
HAPLY = {
    "pull": ("slow", "pull", "gaps"),
    "freeze": ("hold", "freeze", "no frozen readings"),
    "nan": ("slow", "nan", "finite positions"),
    "jump M": ("slow", "jump 0.02", "no jumps"),
    "sign": ("hold", "sign", "sign of forces"),
    "late S": ("slow", "late 0.02", "rate"),
    "drive-late S": ("rest", "drive-late 0.04", "rendering stiffness"),
    "sleep": ("rest", "sleep", "dead-man"),
    "press a|b|c": ("button", "press b", "buttons"),
    "lose-home": ("slow", "lose-home", "gaps"),
}
MENDED_OR_HANDS = {"plug", "thaw", "number", "wake", "release a|b|c", "home", "push N", "arm M", "loose"}
# By what a double is told: in which step, with which value, and the check that finds it.
DOUBLES: dict[str, tuple[str, float, str]] = {
    "unplugged": ("slow", 1.0, "gaps"),
    "uncalibrated": ("slow", 1.0, "gaps"),
    "not_a_number": ("slow", 1.0, "finite positions"),
    "frozen": ("hold", 1.0, "no frozen readings"),
    "latency_s": ("slow", 0.02, "rate"),
    "drive_delay_s": ("rest", 0.0, "rendering stiffness"),
}
HANDS = {"push_n", "hand_m", "loose"}


def test_every_fault_of_the_emulators_is_in_a_table() -> None:
    assert set(HAPLY) | MENDED_OR_HANDS == set(haply_service.ORDERS.split(" | "))
    assert set(DOUBLES) | HANDS == set(live_devices.LINES)
    given = {name for faults in (simulated.SOME | simulated.FURTHER).values() for name in faults}
    assert given | {"stumble", "stuck_buttons"} == set(simulated_link.DeviceFaults._fields)


@check
@pytest.mark.parametrize("kind", ["haply", "dhd", "hd"])
def test_a_good_device_that_takes_a_force_passes(kind: str, tmp_path: Path) -> None:
    page = page_of(wire_trial(kind, tmp_path, lambda bench: nothing), tmp_path)
    others = {name: found for name, found in page.items() if found[0] != "passed"}
    assert set(others) == ({"orientation"} if kind == "dhd" else set()), others


@pytest.mark.drawn(0.25)
@check
@pytest.mark.parametrize("word", HAPLY)
def test_each_fault_of_the_emulated_inverse_service_is_on_the_page(word: str, tmp_path: Path) -> None:
    step, line, name = HAPLY[word]

    def put(bench: Any) -> Put:
        def act() -> None:
            # A person who holds the cable and the buttons would put both right at once.
            bench.device.service.has_person &= word not in ("pull", "press a|b|c")
            haply_service.obey(bench.device.service, line)

        return at(step, act)

    result, reason = page_of(wire_trial("haply", tmp_path, put), tmp_path)[name]
    assert result == "**failed**" and reason, (result, reason)


@pytest.mark.drawn(0.25)
@check
@pytest.mark.parametrize("kind", ["dhd", "hd"])
@pytest.mark.parametrize("word", DOUBLES)
def test_each_fault_of_the_doubles_is_on_the_page(word: str, kind: str, tmp_path: Path) -> None:
    step, value, name = DOUBLES[word]
    stiffness = None
    if word == "drive_delay_s":
        value, stiffness = SWINGS[kind]
    page = page_of(wire_trial(kind, tmp_path, lambda bench: at(step, lambda: bench.device.double.set(word, value)),
                              stiffness), tmp_path)  # fmt: skip
    assert page[name][0] == "**failed**" and page[name][1], page[name]


def simulated_trial(faults: dict[str, Any], guide: Guide = SILENT, stop: str = simulated.STOP) -> Trial:
    config = HapticConfig.model_validate({"driver": "simulated_impedance"})

    def record(led: Guide) -> Any:
        return make_take(config, simulated.MASS_KG, stop, pace=simulated.PACE, faults=faults, guide=led)

    return make_trial("simulated_impedance", TriedDevice(record, ()), guide)


@pytest.mark.drawn(0.25)
@check
@pytest.mark.parametrize("name", [*simulated.SOME, *simulated.FURTHER, "stuck"])
def test_each_fault_of_the_simulated_device_is_on_the_page(name: str, tmp_path: Path) -> None:
    faults = (simulated.SOME | simulated.FURTHER | {"stuck": {"stuck_buttons": 2}})[name]
    found = page_of(simulated_trial(faults), tmp_path)["buttons" if name == "stuck" else name]
    assert found[0] == "**failed**" and found[1], found


# --- instruments


def instrument_trial(driver: str, hook: Any = None, *, safety: Any = None, model: Any = None, **changes: Any) -> Trial:
    chosen, step = instruments.config(driver, **(safety or {})), [""]
    if changes.pop("stiff", False):
        stiff = {"tip_sample": {"sample_modulus_pa": 1e13, "tip_modulus_pa": 1e13}}
        changes["afm"] = instruments.simulated_afm(instruments.AfmConfig.model_validate(stiff).to_params())
    line = instruments.line_of(driver, chosen.to_params().safety, **changes)
    for name, value in (model or {}).items():
        assert hasattr(line.model, name), name
        setattr(line.model, name, value)

    def wait(deadline_ns: int) -> None:
        while line.now_ns < deadline_ns:
            line.pass_ms(1)
            if hook is not None:
                hook(line, step[0])

    def record(guide: Guide) -> Any:
        line.driver.open()
        facts = facts_of_instrument(chosen, line.driver)
        return record_instrument_take(line.driver, facts, Clock(lambda: line.now_ns, wait), guide)

    return make_trial(driver, TriedDevice(record, ()), Guide(lambda begun: step.__setitem__(0, begun.name)))


def late(line: Any, step: str) -> None:
    line.latency_ms = 20.0


# By the options of `device simulate` and the faults of the models: the emulator, what is put in, the check.
INSTRUMENTS: dict[str, tuple[str, dict[str, Any], str]] = {
    "t7 --latency": ("modbus", {"hook": late}, "latency"),
    "t7 --noise": ("modbus", {"model": {"_noise_v": 3e-4}}, "noise at rest"),
    "t7 --travel": ("modbus", {"model": {"_m_per_v": 3.2e-7}}, "scale of the force"),
    "t7 words swapped": ("modbus", {"model": {"_word_swapped": True}}, "opening"),
    "t7 without its script": ("modbus", {"hook": instruments.without_script}, "watchdog"),
    "gwyscope --noise": ("gwyscope", {"model": {"_noise_v": 3e-3}}, "noise at rest"),
    "gwyscope stands": ("gwyscope", {"hook": instruments.halting}, "rate of samples"),
    "nanonis --tap": ("nanonis", {"tap_s": 20.0}, "opening"),
    **{f"{given[0]}: {name}": (*given, name) for name, given in instruments.FAULTS.items() if name != "surface"},
}
# What a driver asks the device for and then expects of it; docs/trial.md says so.
DECLARED = {"gwyscope --tick"}
# where an emulator serves, what is behind it, and what it writes
ADDRESSES = {"--host", "--port", "--log-port", "--scenario", "--calibration", "--fast-path", "--fast-path-port"}


def test_every_option_of_the_emulated_instruments_is_in_the_table() -> None:
    found = set()
    for name in ("t7", "gwyscope", "nanonis"):
        found |= {f"{name} {option}" for option in options_of("device", "simulate", name) - ADDRESSES - {"--help"}}
    assert found == {name for name in INSTRUMENTS if " --" in name} | DECLARED


@pytest.mark.drawn(0.25)
@check
@pytest.mark.parametrize("word", INSTRUMENTS)
def test_each_fault_of_the_emulated_instruments_is_on_the_page(word: str, tmp_path: Path) -> None:
    driver, given, name = INSTRUMENTS[word]
    page = page_of(instrument_trial(driver, **given), tmp_path)
    assert page[name][0] == "**failed**" and page[name][1], page


@check
@pytest.mark.parametrize("driver", ["modbus", "gwyscope", "nanonis"])
def test_a_good_instrument_passes(driver: str, tmp_path: Path) -> None:
    page = page_of(instrument_trial(driver), tmp_path)
    assert {name: found for name, found in page.items() if found[0] != "passed"} == {}


# --- a handle


class TriedHandle:
    """A trial of the emulated handle in virtual time, with a person at it."""

    def __init__(self, put: Callable[[HandleLine, str], None] = lambda line, step: None, **changes: Any) -> None:
        self._calibration = calibration(**changes)
        self.line, self._put, self._step = HandleLine(self._calibration), put, ""

    def trial(self) -> Trial:
        return make_trial("serial", TriedDevice(self._record, ()), Guide(self._say))

    def _record(self, guide: Guide) -> Any:
        line = self.line
        line.driver.open()
        return record_take(
            line.driver, facts_of(line.driver, self._calibration), Clock(lambda: line.now_ns, self._wait), guide
        )

    def _say(self, step: Step) -> None:
        self._step, self._began_ns = step.name, self.line.now_ns
        self._put(self.line, step.name)

    def _wait(self, deadline_ns: int) -> None:
        line = self.line
        while line.now_ns < deadline_ns:
            at_s = (line.now_ns - self._began_ns) * 1e-9
            if self._step == "push":
                line.handle.load(1.0 if 1.0 < at_s < 3.0 else 0.0)
                line.handle.place(2e-3 * (1.0 < at_s < 3.0))
            if self._step == "cable":
                line.plugged = not 1.0 < at_s < 3.0
            line.pass_ms(1)


def unplugged(line: HandleLine, step: str) -> None:
    line.plugged = step != "follow"


def reset(line: HandleLine, step: str) -> None:
    if step == "follow":
        line.handle.reset(0xDEAD)


def with_latency(line: HandleLine, step: str) -> None:
    line.latency_ms = 12.0


def with_bad_bytes(line: HandleLine, step: str) -> None:
    def flipped(sent: bytes) -> bytes:
        return bytes([*sent[:-3], sent[-3] ^ 1, *sent[-2:]]) if sent and line.now_ns % 97_000_000 == 0 else sent

    line.to_host = flipped


def with_estop(line: HandleLine, step: str) -> None:
    line.handle.estop_pressed = step == "follow"


def good_position() -> dict[str, Any]:
    from telenano_devices.handle.emulated_handle import M_PER_COUNT, N_PER_COUNT, POSITION_ZERO

    return {"position": {"zero_raw": POSITION_ZERO, "m_per_count": -M_PER_COUNT},
            "force": {"zero_raw": 0, "n_per_count": N_PER_COUNT, "saturation_n": 100.0}}  # fmt: skip


HANDLES: dict[str, tuple[dict[str, Any], str]] = {
    "the cable is out": ({"put": unplugged}, "losses"),
    "the board is reset": ({"put": reset}, "losses"),
    "answers are late": ({"put": with_latency}, "age of samples"),
    "bytes are bad": ({"put": with_bad_bytes}, "frames"),
    "the emergency stop is pressed": ({"put": with_estop}, "emergency stop"),
    "places count the other way": ({"position": good_position()["position"]}, "sign of places"),
    "the zero of the force is another": ({"force": good_position()["force"]}, "zero of the force"),
    "another device": ({"device_id": "00000000000000ff"}, "opening"),
}


@pytest.mark.drawn(0.25)
@check
@pytest.mark.parametrize("word", HANDLES)
def test_each_fault_of_the_emulated_handle_is_on_the_page(word: str, tmp_path: Path) -> None:
    given, name = HANDLES[word]
    page = page_of(TriedHandle(**given).trial(), tmp_path)
    assert page[name][0] == "**failed**" and page[name][1], page


@check
def test_a_good_handle_passes(tmp_path: Path) -> None:
    page = page_of(TriedHandle().trial(), tmp_path)
    assert {name: found for name, found in page.items() if found[0] != "passed"} == {}


# --- questions, the end at any time, and the file

QUICK = ["device", "trial", "simulated_impedance", "--set", "haptic_node.impedance.model=omega"]


def typed(folder: Path, text: str, *options: str) -> tuple[int, str, Path]:
    """Run the command with what a person types; return its exit code, what it printed, and its file."""
    path = folder / "trial.zip"
    done = invoke(["device", "trial", *options, "--out", str(path)], input=text)
    return done.exit_code, " ".join(done.output.split()), path


def led(steps: dict[str, Any], polls: int = 0) -> Guide:
    """Return a guide who answers by the name of a step, and ends it in the first poll after so many, if any."""
    seen = [0]

    def ask(step: Step, idle: Callable[[], None]) -> bool:
        for _ in range(3):
            idle()
        answer = steps.get(step.name, True)
        if answer == "end":
            raise EndedError("the person has ended it")
        return bool(answer)

    def poll() -> None:
        seen[0] += 1
        if seen[0] == polls:
            raise EndedError("the person has ended it")

    return Guide(ask=ask, poll=poll)


def test_a_step_that_is_not_wanted_is_left_out_and_asked_for_on_the_page(tmp_path: Path) -> None:
    page = page_of(simulated_trial({}, led({"mass": False, "cable": False})), tmp_path)
    assert page["scale of forces"] == ("to be made again", "the step mass was not made")
    assert page["cable loss"] == ("to be made again", "the step cable was not made")
    assert page["sign of x"][0] == page["sign of forces"][0] == page["whole motion"][0] == "passed"


@pytest.mark.parametrize("guide", [led({"right": "end"}), led({}, polls=4500)], ids=["at a question", "in a step"])
def test_an_end_at_any_time_leaves_what_was_found_so_far(guide: Guide, tmp_path: Path) -> None:
    trial = simulated_trial({}, guide)
    page = page_of(trial, tmp_path)
    assert page["noise at rest"][0] == "passed" and page["sign of forces"][0] == "to be made again"
    assert page["whole motion"][0] == "to be made again" and "the person has ended it" in page["whole motion"][1]
    assert trial.take is not None and not trial.take.rows["force_n"][-1].any()


def test_an_instrument_whose_trial_is_ended_is_retracted(tmp_path: Path) -> None:
    for hook in (led({"approach": False}), led({"silence": "end"})):
        chosen = instruments.config("simulated")
        from telenano.devices import driver_of

        driver = driver_of(chosen, 1e-3)
        driver.open()
        facts = facts_of_instrument(chosen, driver)
        take = record_instrument_take(driver, facts, Clock(lambda: 0), hook)
        assert take.rows["base_m"][-1] == facts.limits.retract_position_m
        assert take.facts.stopped in ("the step approach was declined", "the person has ended it")


def test_questions_are_answered_on_the_terminal_and_the_page_is_the_same_from_the_file(tmp_path: Path) -> None:
    code, output, path = typed(tmp_path, "y\nwhat\nn\nend\n", "simulated_impedance")
    assert code == 1, output
    assert "rest (read only, 8 s): put the handle down, or hold it still." in output
    assert "'what' is not y, n or end" in output
    assert "the person has ended it" in output
    with zipfile.ZipFile(path) as archive:
        assert set(archive.namelist()) == {"acceptance.json", "take.npz", "versions.json", "errors.json"}
    done = invoke(["device", "trial", "--read", str(path)])
    assert done.exit_code == 0 and " ".join(done.stdout.split()) in output
    # an input that ends is an end as well
    assert "the person has ended it" in typed(tmp_path, "y\n", "simulated_impedance")[1]


@check
def test_ctrl_c_at_a_question_ends_it_with_a_file(tmp_path: Path) -> None:
    path = tmp_path / "trial.zip"
    command = [
        sys.executable,
        "-P",
        "-u",
        "-m",
        "telenano",
        "device",
        "trial",
        "simulated_impedance",
        "--out",
        str(path),
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert any("Begin?" in line for line in process.stdout)
        process.send_signal(signal.SIGINT)
        output = process.stdout.read()
        assert process.wait() == 1, output
    assert "the person has ended it" in output
    assert {line.result for line in read_trial(path).acceptance.lines} == {"pass", "retake"}


@pytest.mark.usefixtures("without_realtime")
def test_the_collector_leaves_alone_what_was_there_before_the_device_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Going through all of it takes a tenth of a second, which a watchdog takes for the death of this process."""
    frozen: list[int] = []

    def opened(*settings: Any) -> None:
        frozen.append(gc.get_freeze_count())
        raise EndedError("enough")

    monkeypatch.setattr(devices.ProcessLink, "open", opened)
    try:
        assert typed(tmp_path, "", "haply")[0] != 0
        assert frozen[0] > 10_000
        # guards and emulators do so as well, and the trials of the other devices
        gc.unfreeze()
        run_ahead()
        assert gc.get_freeze_count() > 10_000
    finally:
        gc.unfreeze()


def test_yes_is_for_emulators_only(tmp_path: Path) -> None:
    from telenano_devices.acceptance.trial.questions import Questions

    Questions(lambda text: None, yes=True).guide.met("omega.3, emulated")
    Questions(lambda text: None, yes=True, is_emulated=True).guide.met("LabJack T7 470012345")
    with pytest.raises(ConfigError, match=r"--yes: is for emulators, and this is omega\.3"):
        Questions(lambda text: None, yes=True).guide.met("omega.3")


def test_a_busy_computer_is_on_the_page_and_is_no_fault_of_the_device(tmp_path: Path) -> None:
    from telenano_devices.acceptance.trial.questions import Questions

    for late_s, result in ((0.0005, "passed"), (0.03, "to be made again")):
        questions = Questions(lambda text: None, yes=True)
        for _ in range(50):
            questions.guide.waited(late_s)
        device = TriedDevice(lambda guide: make_take(HapticConfig.model_validate({"driver": "simulated_impedance"}),
                                               pace=0.01, guide=guide), ())  # fmt: skip
        page = page_of(make_trial("simulated_impedance", device, SILENT, questions.computer), tmp_path)
        assert page["this computer"][0] == result
        assert "30 ms at most" in page["this computer"][1] or result == "passed"


def test_what_cannot_be_tried_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for options, text in (
        ([], "name the device to try, such as `telenano device trial haply`"),
        (["haplyy"], "haplyy: "),
        (["t7"], "t7: give its calibration file by --calibration FILE"),
        (["serial"], "serial: give the port of the handle by --port"),
        (["haply", "--port", "/dev/ttyUSB0"], "are not for haply"),
        (
            ["haply", "--set", "controller.law=wave"],
            "--set controller: only keys haptic_node.* can be set here",
        ),
    ):
        code, output, path = typed(tmp_path, "", *options)
        assert code == 2 and text in output and not path.exists(), output
    service = "haptic_node.haply.service=ws://127.0.0.1:9"
    code, output, path = typed(tmp_path, "", "haply", "--set", service)
    assert code == 2 and "no Inverse Service answers" in output, output
    assert page_of(read_trial(path), tmp_path)["opening"][0] == "**failed**"
    monkeypatch.setenv("FDSDK", str(tmp_path))
    code, output, path = typed(tmp_path, "", "dhd")
    assert code == 2 and "Force Dimension SDK (libdhd) is not installed" in output, output


def test_the_file_names_no_user_machine_folder_or_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home" / "wilhelmine"
    work = home / "geheimlabor"
    work.mkdir(parents=True)
    names = ("wilhelmine", "afm-pc-17", "geheimlabor", "192.168.7.31", "handle.example", "ttyACM0", str(tmp_path))
    monkeypatch.setenv("USER", "wilhelmine")
    monkeypatch.setenv("LOGNAME", "wilhelmine")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setattr(socket, "gethostname", lambda: "afm-pc-17.example.org")
    monkeypatch.chdir(work)
    said = (
        f"{home}/lib/libdhd.so on afm-pc-17 of wilhelmine: ws://handle.example:10001 and 192.168.7.31:502, "
        f"{work}/handle.yaml, geheimlabor/handle.yaml, wilhelmine@afm-pc-17.example.org, /dev/ttyACM0: 3.2 N/m"
    )
    stop = "the switch of wilhelmine in the supply, 0.5 N/m"
    good = simulated_trial({}, stop=stop)
    assert good.take is not None

    def record(guide: Guide) -> Any:
        take = make_take(
            HapticConfig.model_validate({"driver": "simulated_impedance"}), 0.0, stop, pace=0.05, guide=guide
        )
        device = take.facts.device._replace(identity=f"simulated, {said}")
        return take._replace(facts=take.facts._replace(device=device, device_messages=(said,), stopped=said))

    def broken(guide: Guide) -> Any:
        raise ValueError(said)

    for made in (record, broken):
        trial = make_trial("haply", TriedDevice(made, ("handle.example",)), SILENT)
        write_trial(work / "trial.zip", trial)
        contents = {"page": sheet_of(trial).encode()}
        with zipfile.ZipFile(work / "trial.zip") as archive:
            contents |= {name: archive.read(name) for name in archive.namelist()}
        if "take.npz" in contents:
            (work / "take.npz").write_bytes(contents["take.npz"])
            with zipfile.ZipFile(work / "take.npz") as archive:
                contents |= {name: archive.read(name) for name in archive.namelist()}
        for member, content in contents.items():
            # numpy writes letters as four bytes
            plain = content.replace(b"\0", b"")
            found = [name for name in names if name.encode() in plain]
            assert found == [], (member, found)
        assert "3.2 N/m" in contents["page"].decode()


def test_a_file_that_is_damaged_or_larger_than_a_trial_is_refused_by_its_name(tmp_path: Path) -> None:
    trial = simulated_trial({}, led({"slow": "end"}))
    path = tmp_path / "good.zip"
    write_trial(path, trial)
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}

    def written(name: str, **changes: bytes | None) -> None:
        with zipfile.ZipFile(tmp_path / name, "w", zipfile.ZIP_DEFLATED) as archive:
            for member, content in (members | changes).items():
                if content is not None:
                    archive.writestr(member, content)

    flipped = bytearray(whole)
    flipped[len(whole) // 3] ^= 0xFF
    for name, content in (("cut", whole[:-40]), ("half", whole[: len(whole) // 2]), ("flipped", bytes(flipped)),
                          ("text", b"none"), ("empty", b"")):  # fmt: skip
        (tmp_path / name).write_bytes(content)
    written("more", **{"../other": b"x"})
    written("without", **{"versions.json": None})
    written("large", **{"errors.json": b" " * 2**21})
    written("other", **{"acceptance.json": b'{"schema": 1}'})
    written("newer", **{"acceptance.json": members["acceptance.json"].replace(b'"schema": 1', b'"schema": 2')})
    written("take", **{"take.npz": members["take.npz"][:-30]})
    # each copy would be unpacked, 32 MB from 33 kB
    with zipfile.ZipFile(tmp_path / "often", "w", zipfile.ZIP_DEFLATED) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        archive.writestr("acceptance.json", members["acceptance.json"])
        archive.writestr("take.npz", bytes(32 * 2**20))
        archive.writestr("take.npz", bytes(32 * 2**20))
    os.mkfifo(tmp_path / "pipe")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("a member is unpacked"))
        with pytest.raises(ConfigError, match=r"its member 'take\.npz' comes twice"):
            read_trial(tmp_path / "often")
    for name in (
        "cut",
        "half",
        "flipped",
        "text",
        "empty",
        "more",
        "without",
        "large",
        "other",
        "newer",
        "take",
        "often",
        "pipe",
        "none",
    ):
        done = invoke(["device", "trial", "--read", str(tmp_path / name)])
        output = " ".join(done.output.split())
        reason = "cannot be read" if name in ("pipe", "none") else "is no"
        assert done.exit_code == 2 and f"{tmp_path / name}: {reason}" in output, (name, output)


def test_the_page_says_where_the_version_here_judges_otherwise(tmp_path: Path) -> None:
    trial = simulated_trial({}, led({"slow": "end"}))
    path = tmp_path / "trial.zip"
    write_trial(path, trial)
    assert json.loads(zipfile.ZipFile(path).read("acceptance.json"))["driver"] == "simulated_impedance"
    lines = [line if line.check != "noise at rest" else type(line)(line.check, line.load, "fail", "", "")
             for line in trial.acceptance.lines]  # fmt: skip
    import msgspec

    bell = msgspec.structs.replace(trial.acceptance, driver="\x1b]0;x\x07", device="a\x1b[2J | b", result="\x9b31m")
    assert sheet_of(trial._replace(acceptance=bell)).replace("\n", " ").isprintable()
    other = trial._replace(acceptance=msgspec.structs.replace(trial.acceptance, lines=lines))
    assert judged_again(other) == ["noise at rest: pass here, fail in the file"]

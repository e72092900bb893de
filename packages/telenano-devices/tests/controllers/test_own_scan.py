"""An image by the controller's own scan, as a program of the node: its lines, and what ends it."""

from typing import Any

import numpy as np
import pytest
from controller_faults import ControllerRig
from telenano_devices.doubles.controller_line import Nanonis
from telenano_devices.nanonis import nanonis_model, nanonis_wire

from telenano.testing import afm_config, instrument_of
from telenano.wire import RefusedError

SIDE_M = 60e-9
SCAN = {"program": "scan", "scan.pixels": 16, "scan.lines": 2, "scan.dwell_s": 0.006, "scan.width_m": SIDE_M,
        "scan.depth_m": SIDE_M}  # fmt: skip
SECTION: dict[str, Any] = {"driver": "nanonis", "nanonis": {"calibration": "nanonis.yaml"}}


def rig_over(bench: Any, section: dict[str, Any]) -> ControllerRig:
    line = Nanonis(afm=instrument_of(section | {"driver": "simulated"}))
    # a quicker z-controller than the emulator's usual one, for a shorter approach
    line.model._values["ZCtrl.Gain"] = [2e-7, 1e-3, 2e-4]
    found = ControllerRig(bench, line, section)
    found.tick(80)
    return found


@pytest.fixture
def rig(bench_of: Any) -> ControllerRig:
    """Return a node with a controller over a plane."""
    return rig_over(bench_of("afm_node@slave"), SECTION)


def lines_of(rig: ControllerRig, most_ms: int = 20_000) -> tuple[list[Any], str]:
    """Return the lines that come until the program is over, and the text of its end."""
    found: list[Any] = []
    for _ in range(most_ms):
        rig.tick(1)
        found += rig.bench.take("afm/scanline")
        reports = [report for report in rig.bench.take("afm/program") if report.state in ("finished", "ended")]
        if reports:
            return found, reports[-1].text
    raise AssertionError(f"no end; {len(found)} lines")


@pytest.mark.endurance
def test_lines_are_those_of_the_sample(bench_of: Any) -> None:
    section = SECTION | {"sample": {"name": "dots"}}
    rig = rig_over(bench_of("afm_node@slave"), section)
    rig.control("set", **(SCAN | {"scan.lines": 3, "scan.dwell_s": 0.02}))
    found, _ = lines_of(rig)
    surface = afm_config(section).to_surface()
    assert surface is not None
    for way in ("trace", "retrace"):
        heights = np.array([line.height_m.to_numpy() for line in found if line.direction == way])
        xs = ((np.arange(16) + 0.5) / 16 - 0.5) * SIDE_M + 0.5 * surface.width_m
        ys = ((np.arange(3) + 0.5) / 3 - 0.5) * SIDE_M + 0.5 * surface.depth_m
        cut = np.ix_((ys / surface.step_y_m).astype(int), (xs / surface.step_x_m).astype(int))
        truth = surface.height_m[cut]
        assert np.corrcoef(heights.ravel(), truth.ravel())[0, 1] > 0.95
    # a second image begins as the first one did
    rig.tick(200)
    rig.control("set", **SCAN)
    assert len(lines_of(rig)[0]) == 4


def test_an_image_comes_line_by_line_and_the_tip_is_withdrawn_at_the_end(rig: ControllerRig) -> None:
    assert "by the instrument's own scan begins, 0 s for its lines" in rig.control("set", **SCAN)
    found, end = lines_of(rig)
    assert end == "the scan is finished: the tip retracts"
    assert [(line.line, line.direction) for line in found] == [
        (number, way) for number in range(2) for way in ("trace", "retrace")
    ]
    assert found[0].start_m == pytest.approx((-SIDE_M * 15 / 32, -SIDE_M / 4, 0.0))
    assert found[0].lateral_force_n is None
    for line in found:
        # a plane, pressed with 5 nN over 10 nm
        assert np.ptp(line.height_m.to_numpy()) < 0.2e-9
        assert line.height_m.to_numpy().mean() == pytest.approx(-10e-9, abs=2e-9)
    rig.tick(200)
    assert rig.line.model.status == nanonis_model.OFF
    assert rig.bench.take("afm/state")[-1].mode == "retracted"
    assert rig.line.base_m <= -100e-9 + 1e-12


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scan.pixels": 20}, "takes lines of 16, 32, 48... pixels"),
        ({"scan.mode": "tapping"}, "takes images in contact"),
        ({"scan.x_m": 5e-5}, "the image reaches 5e-05 m from the centre"),
        ({"scan.dwell_s": 1e-5}, "a line would be faster than lateral.speed_m_per_s"),
        ({"scan.setpoint_n": 1e-6}, "must be above 0 and below safety.force_limit_n"),
    ],
)
def test_an_image_that_the_controller_cannot_take_is_refused_in_words(
    rig: ControllerRig, change: dict[str, Any], words: str
) -> None:
    with pytest.raises(RefusedError, match=words):
        rig.control("set", **{**SCAN, **change})


def ask(line: Nanonis, command: str, *arguments: Any) -> Any:
    return nanonis_wire.returned(command, line.served(nanonis_wire.request(command, *arguments), line.now_ns) or b"")


def strike(rig: ControllerRig) -> None:
    rig.line.model._values["ZCtrl.Gain"] = [0.0, 0.0, 0.0]
    rig.line.model.safe_tip, rig.line.model._external_m = False, 1.8e-8


ENDS = {
    "aborted": (lambda rig: rig.control("set", program="abort"), "it was aborted", False),
    "emergency stop": (lambda rig: rig.control("estop"), "the guard has retracted the tip: estop", False),
    "force limit": (strike, "the guard has retracted the tip: force_limit", False),
    "connection lost": (lambda rig: rig.line.close(), "the guard has retracted the tip: device_lost", True),
    "scan stopped from outside": (
        lambda rig: ask(rig.line, "Scan.Action", 1, 1), "the guard has retracted the tip: device_lost", True,
    ),
    "withdrawn from outside": (
        lambda rig: ask(rig.line, "ZCtrl.Withdraw", 0, -1), "the guard has retracted the tip: device_lost", True,
    ),
    "z-controller switched off from outside": (
        lambda rig: ask(rig.line, "ZCtrl.OnOffSet", 0), "the guard has retracted the tip: device_lost", True,
    ),
}  # fmt: skip


# the loss of the connection is tried in every run, the rest in `make endurance`
QUICK = ("connection lost",)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.endurance) for name in ENDS]
)
def test_whatever_ends_an_image_withdraws_the_tip(rig: ControllerRig, name: str) -> None:
    begin, words, lost = ENDS[name]
    rig.control("set", **SCAN)
    for _ in range(8000):
        rig.tick(1)
        if rig.bench.take("afm/scanline"):
            break
    assert rig.line.model.status == nanonis_model.ON
    rig.bench.take("session/event")
    begin(rig)
    _, end = lines_of(rig, 1500)
    assert end == f"the scan ended, {words}"
    rig.tick(1500 if lost else 100)
    assert (rig.line.model.status, ask(rig.line, "Scan.StatusGet")) == (nanonis_model.OFF, [0])
    assert rig.line.model.z_m >= 1e-7 - 1e-12
    state = rig.bench.take("afm/state")[-1]
    assert (state.mode, state.device) == ("estop" if name == "emergency stop" else "retracted", "ok")
    lost_texts = [event.text for event in rig.bench.take("session/event") if "127.0.0.1:" in event.text]
    # one event of the loss, and one of the recovery
    assert len(lost_texts) == (2 if lost else 0), lost_texts


def test_the_end_of_the_node_in_an_image_stops_the_scan_and_withdraws_the_tip(rig: ControllerRig) -> None:
    rig.control("set", **SCAN)
    for _ in range(8000):
        rig.tick(1)
        if rig.bench.take("afm/scanline"):
            break
    rig.bench.take("session/event")
    rig.node.make_safe()
    assert (rig.line.model.status, ask(rig.line, "Scan.StatusGet")) == (nanonis_model.OFF, [0])
    assert rig.line.model.z_m == pytest.approx(5e-7, abs=1e-12)
    assert not [event for event in rig.bench.take("session/event") if "not confirmed" in event.text]


def test_the_tip_lift_of_the_file_is_set_and_read_back(bench_of: Any) -> None:
    line = Nanonis(tip_lift_m=3e-8)
    line.driver.open()
    assert ask(line, "ZCtrl.TipLiftGet") == [pytest.approx(3e-8)]
    ask(line, "ZCtrl.ZPosSet", 1e-7)
    ask(line, "ZCtrl.OnOffSet", 1)
    before = line.model.z_m
    ask(line, "ZCtrl.OnOffSet", 0)
    line.pass_ms(10)
    assert line.model.status == nanonis_model.OFF
    assert line.model.z_m == pytest.approx(before + 3e-8, abs=2e-9)

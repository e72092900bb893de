"""What the wires of devices share: a frame there and back, a cadence, the dead-man button, and what is declared."""

import math
import re
import sys
from itertools import pairwise, permutations, product
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from telenano_devices.doubles.servo_bench import VirtualTime
from telenano_devices.impedance import Cadence, Declared, DeviceSample, Frame, declared
from telenano_devices.impedance.impedance import takes_force
from telenano_devices.impedance.wires import Mechanics

AXES = [
    " ".join(sign + axis for sign, axis in zip(signs, order, strict=True))
    for order in permutations("xyz")
    for signs in product(("", "-"), repeat=3)
]


def matrix_of(axes: str) -> np.ndarray:
    """Return P with master = P device, from the words alone."""
    rows = np.zeros((3, 3))
    for row, name in enumerate(axes.split()):
        rows[row, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return rows


@pytest.mark.parametrize("axes", AXES)
def test_a_vector_goes_there_and_back_and_an_orientation_is_turned_with_it(axes: str) -> None:
    frame, matrix = Frame(axes), matrix_of(axes)
    vector = (0.1, -0.2, 0.3)
    assert frame.to_master(vector) == tuple(matrix @ vector)
    assert frame.to_device(frame.to_master(vector)) == vector
    if np.linalg.det(matrix) < 0.0:
        return  # a frame of the other hand has no rotation
    angle = 0.7
    turned = np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0, 0, 1]])
    w, x, y, z = frame.orientation(turned.tolist())
    axis = matrix @ (0.0, 0.0, 1.0)
    assert w == pytest.approx(math.cos(angle / 2), rel=1e-12)
    assert (x, y, z) == pytest.approx(tuple(math.sin(angle / 2) * axis), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("axes", ["", "x y", "x y y", "x y z z", "x y -w", "+x y z", "x,y,z"])
def test_axes_that_are_no_frame_are_refused(axes: str) -> None:
    with pytest.raises(ValueError, match="must name x, y and z once each"):
        Frame(axes)


def test_a_button_that_has_to_be_held_is_the_one_of_its_number() -> None:
    frame = Frame("x y z")
    for deadman, buttons in product((None, 0, 1, 5), (0, 1, 2, 32)):
        sample = frame.sample((0.0, 0.0, 0.0), 7, buttons=buttons, deadman=deadman)
        assert sample.deadman is (deadman is None or buttons == 1 << deadman)
        assert (sample.taken_ns, sample.deadman_ns, sample.buttons) == (7, 7, buttons)


def test_a_cadence_is_absolute_and_does_not_make_up_for_a_turn_that_took_long() -> None:
    time = VirtualTime()
    cadence, begun_ns, turns = Cadence(1000.0, time.now_ns, time.sleep), time.ns, list[int]()
    for taken_ns in (100_000, 900_000, 0, 25_000_000, 0, 300_000, 0):
        time.ns += taken_ns
        cadence.wait()
        turns.append(time.ns - begun_ns)
    ms = 1_000_000
    assert turns[:3] == [ms, 2 * ms, 3 * ms]
    # a turn of 25 ms is followed by two at once, and by no more
    assert turns[3:] == [28 * ms, 28 * ms, 29 * ms, 30 * ms]


def test_what_is_declared_is_a_ball_or_the_ends_that_are_given() -> None:
    ball = declared("a ball", Declared(3.0, 400.0, 4.0, 0.1), 500)
    assert (ball.workspace_min_m, ball.workspace_max_m, ball.lateral_m) == (-0.1, 0.1, ((-0.1, 0.1), (-0.1, 0.1)))
    assert (ball.rate_hz, ball.drive_delay_s, ball.damping_n_s_per_m, ball.mass_kg) == (500.0, 0.002, 0.0, 0.0)
    ends = ((-0.2, 0.3), (-0.1, 0.4), (-0.05, 0.15))
    box = declared("a box", Declared(3.0, 400.0, 4.0, ends=ends), 500, arm=Mechanics(0.2, 0.5))
    # towards the sample is down
    assert (box.workspace_min_m, box.workspace_max_m, box.lateral_m) == (-0.15, 0.05, ends[:2])
    assert (box.identity, box.mass_kg, box.damping_n_s_per_m) == ("a box, emulated", 0.2, 0.5)


def test_the_device_of_the_documents_runs_as_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "own-device.md").read_text(encoding="utf-8")
    driver, wire = re.findall(r"```python\n(# my_package/.*?)```", page, re.DOTALL)
    for name, text in (("my_package", driver), ("my_package.wire", wire)):
        module = ModuleType(name)
        exec(text, module.__dict__)
        monkeypatch.setitem(sys.modules, name, module)
    made = sys.modules["my_package"].MY_DEVICE
    assert takes_force(made) and made.name == "my_device"
    device = made.own.wire(made.settings({"rate_hz": 4000.0}))
    assert (device.open().kind, device.open().rate_hz) == ("impedance", 4000.0)
    samples: list[DeviceSample] = []

    def turn(sample: DeviceSample) -> tuple[float, float, float] | None:
        samples.append(sample)
        return (0.1, 0.2, 0.3) if len(samples) < 20 else None

    device.run(turn)
    device.close()
    assert len(samples) == 20
    assert all(after.taken_ns >= before.taken_ns for before, after in pairwise(samples))

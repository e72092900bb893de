"""A recorded map of a package: one of another format is felt on its place, and an absent package is named."""

from pathlib import Path
from typing import Any

import pytest

from telenano.testing import install_package, said_with

PACKAGE = """
from typing import NamedTuple

from telenano.extend.maps import MapFormat, OverMap, Span
from telenano.extend.samples import AfmSample
from telenano.numerics import compiled
from telenano.settings import FileReader

class Wall(NamedTuple):
    stiffness_n_per_m: float
    rest_distance_m: float

@compiled
def start(params, inputs):
    return 0.0

@compiled
def step(params, state, inputs, dt):
    force = params.stiffness_n_per_m * max(inputs.base_m + inputs.height_m - params.rest_distance_m, 0.0)
    return state, AfmSample(inputs.base_m, 0.0, force, 0.0, 0.0, False, force > 0.0, False, 0.0, 0.0)

def span(path):
    return Span(-5e-9, 40e-9, 1e-7, 2e-7, 3.0, "force") if path.is_file() else None

def read(path, rest_distance_m, stiffness_n_per_m, volts_per_m):
    return OverMap(Wall(float(path.read_text()), rest_distance_m), 3.0, "", f"{path.name}: a wall")

WALL = FileReader(map=MapFormat(Wall, start, step, span, read))
"""
PROGRAM = """
import json, sys
from pathlib import Path
import telenano
from telenano.sections.afm_section import AfmConfig
from telenano.devices.afm.instrument import driver_of
from telenano.settings.config import validate
from telenano.settings.scenario import named_in
from telenano.wire.errors import ConfigError

path = sys.argv[1]
document = {"sample": {"map": path}}
afm = validate(AfmConfig, document, "mine.yaml", "afm_node")
said = {"named": named_in({"afm_node": document}), "places": afm.places_m, "limits": list(afm.to_guard()[:2])}
try:
    driver = driver_of(afm)
    driver.open()
    said["about"], said["force"] = driver.about, driver.exchange(11e-9).force_n
    said["verdict"] = telenano.simulate("fig12", settings={"afm_node.sample.map": path}, duration_s=0.1).verdict
except ConfigError as error:
    said["refused"] = str(error)
print(json.dumps(said))
"""


def felt(path: Path, **environment: str) -> Any:
    """Return what a process says of a map, with the packages that are installed and one of its own."""
    install_package(path.parent, "of_walls", {"__init__.py": PACKAGE}, {"readers": {"wall": "of_walls:WALL"}})
    return said_with(PROGRAM, path.parent, str(path), **environment)


@pytest.mark.check("takes 0.7 s")
def test_a_map_of_another_format_is_felt_on_its_place(tmp_path: Path) -> None:
    path = tmp_path / "one.wall"
    path.write_text("2.0")
    found = felt(path)
    assert "refused" not in found
    assert found["named"] == [["readers", "wall"]]
    assert found["places"] == [1e-7, 2e-7]
    assert found["force"] == pytest.approx(2.0 * 1e-9, rel=1e-9)
    assert found["about"].startswith("recorded map one.wall: a wall; the tip stays within x ± 1e-07 m")


@pytest.mark.check("takes 0.6 s")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("one.npz", "the map npz is in the package telenano-lab: "),
        ("one.wall", "is of no format that is felt here; known are none"),
    ],
)
def test_without_its_package_a_map_is_refused_by_name(name: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("2.0")
    assert words in felt(path, TELENANO_WITHOUT_PACKAGES="1")["refused"]

"""What names a law of a package that is not installed: each is refused by the name of the package."""

import json
import os
import subprocess
import sys

import pytest

from telenano.settings.known_packages import known_of

LAWS = sorted(known_of("law"))

REFUSED = """
import json, sys
from telenano.sections.controller_section import LAWS, ControllerConfig, changed_config
from telenano.settings.config import validate
from telenano.wire.errors import TelenanoError
ways = {
    "in force": lambda name: validate(ControllerConfig, {"law": name}, "mine.yaml", "controller"),
    "its settings": lambda name: validate(ControllerConfig, {name: {"position_scale": 1e-6}}, "x.yaml", "controller"),
    "set while the rig runs": lambda name: changed_config(ControllerConfig(), {"law": name}),
    "its settings set": lambda name: changed_config(ControllerConfig(), {f"{name}.position_scale": 1e-6}),
    "law show": LAWS.__getitem__,
}
said = {}
for name in sys.argv[1:]:
    for way, ask in ways.items():
        try:
            said[f"{name}: {way}"] = f"accepted: {ask(name)}"
        except TelenanoError as error:
            said[f"{name}: {way}"] = str(error)
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def said() -> dict[str, str]:
    environment = {**os.environ, "TELENANO_WITHOUT_PACKAGES": "1"}
    command = [sys.executable, "-P", "-c", REFUSED, *LAWS]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    found: dict[str, str] = json.loads(run.stdout)
    return found


def test_every_place_that_names_an_absent_law_names_its_package(said: dict[str, str]) -> None:
    assert {"model_mediated", "smith"} <= set(LAWS)
    assert len(said) == 5 * len(LAWS)
    for way, text in said.items():
        assert f"the law {way.partition(':')[0]} is in the package telenano-laws: " in text, way
        assert "\n" not in text


def test_the_table_of_known_laws_is_what_the_package_has() -> None:
    from importlib.metadata import entry_points

    own = {entry.name for entry in entry_points(group="telenano.laws") if entry.value.startswith("telenano_laws.")}
    assert set(LAWS) == own

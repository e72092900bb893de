"""A scenario is data: what it names is read as a file, an address or a name, and never run."""

import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from telenano.settings.included import SCHEMA_DIRECTORY
from telenano.signals import children

SCHEMA = json.loads((SCHEMA_DIRECTORY / "scenario.json").read_text())
# What a key needs beside it, so that it is looked at.
BESIDE_TEXTS = {
    "haptic_node.serial.port": ("calibration",),
    "haptic_node.serial.calibration": ("port",),
    "afm_node.modbus.calibration": ("host",),
    "afm_node.modbus.host": ("calibration",),
}
# The libraries of devices are keys of their package, which tries them.
CODE = {"afm_node.sample.name"}
# In a process of its own: every file that is loaded or run is told, by Python itself.
TRIAL = """
import ctypes, json, sys
from pathlib import Path
from telenano.wire.errors import TelenanoError
from telenano.sections.afm_section import AfmConfig
from telenano.settings.link_settings import LinkSettings
from telenano.settings.link_files import read_files
from telenano.sections.hand_section import HapticConfig
from telenano.launcher.plan import UpRequest, make_plan
from telenano.settings.scenario import LoadedScenario

now, ran, refused = [""], set(), set()

def heard(event, args):
    if event == "ctypes.dlopen" and "evil" in str(args[0]) or event == "import" and "evil" in str(args[0]):
        ran.add(now[0])

sys.addaudithook(heard)

def start(path, folder):
    loaded = LoadedScenario.load(path)
    loaded.section("haptic_node", HapticConfig)
    link = loaded.section("delay_node", LinkSettings)
    for way in ("forward", "backward"):
        read_files(getattr(link, way), folder, way)
    sample = loaded.section("afm_node", AfmConfig).sample
    if sample is not None:
        sample.build()
    make_plan(UpRequest(scenario=str(path), out=folder / "out"), folder / "out")

folder = Path(sys.argv[1])
for path in sorted(folder.glob("trial*.yaml")):
    now[0] = path.read_text().partition("\\n")[0].removeprefix("# ")
    try:
        start(path, folder)
    except TelenanoError as error:
        if "--allow-code" in str(error):
            refused.add(now[0])
    except SystemExit:
        ran.add(now[0])
print(json.dumps({"ran": sorted(ran), "refused": sorted(refused)}))
"""


def texts_of(node: Any, path: str = "", seen: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield each key of the schema that takes any text; `*` stands for a name of a topic."""
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        if name not in seen:
            yield from texts_of(SCHEMA["$defs"][name], path, (*seen, name))
    for inner in (*node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("allOf", ())):
        yield from texts_of(inner, path, seen)
    if node.get("type") == "string" and not {"enum", "const", "pattern"} & set(node):
        yield path
    for name, inner in node.get("properties", {}).items():
        yield from texts_of(inner, f"{path}.{name}".lstrip("."), seen)
    if isinstance(node.get("additionalProperties"), dict):
        yield from texts_of(node["additionalProperties"], f"{path}.*", seen)


KEYS = sorted(set(texts_of(SCHEMA)))


def document_of(key: str, value: str) -> dict[str, Any]:
    found: Any = value
    *above, last = key.replace("*", "haptic/state").split(".")
    found = {last: value, **dict.fromkeys(BESIDE_TEXTS.get(key, ()), value)}
    for name in reversed(above):
        found = {name: found}
    return {"name": "trial", "description": "data", "duration_s": 1.0, **found}


def tried(tmp_path: Path, keys: Iterable[str], **environment: str) -> dict[str, set[str]]:
    (tmp_path / "evil.py").write_text("raise SystemExit\n")
    (tmp_path / "evil.so").write_bytes(b"no library, and the attempt to load it counts")
    number = 0
    for key in sorted(keys):
        for value in ("evil:f", str(tmp_path / "evil.so"), "./evil.so"):
            text = f"# {key}\n{yaml.safe_dump(document_of(key, value))}"
            (tmp_path / f"trial{number:04}.yaml").write_text(text)
            number += 1
    command = [sys.executable, "-c", TRIAL, str(tmp_path)]
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": str(tmp_path), **environment}
    done = children.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {name: set(found) for name, found in json.loads(done.stdout).items()}


@pytest.mark.check("takes 5.2 s")
def test_no_key_of_a_scenario_runs_code(tmp_path: Path) -> None:
    assert set(KEYS) >= CODE and len(KEYS) > 25
    assert tried(tmp_path, KEYS) == {"ran": set(), "refused": CODE}


@pytest.mark.check("takes 4.5 s")
def test_who_starts_the_program_may_allow_it(tmp_path: Path) -> None:
    assert tried(tmp_path, CODE, TELENANO_ALLOW_CODE="1") == {"ran": CODE, "refused": set()}

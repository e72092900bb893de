"""What `telenano up` is to run, checked as a whole before anything is started."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from services.launcher.errors import RigError
from services.runtime.config import layered, merge, validate
from services.runtime.errors import ConfigError
from services.runtime.main import NodeKind, load_site
from services.runtime.scenario import LoadedScenario, Scenario
from services.runtime.site import SiteBook

LAUNCHER = "launcher@master"
RECORDING_NAME = "session.mcap"
# started and stopped in this order: the recorder hears the others come and go, the devices are made safe first
START_ORDER = (
    "recorder@master",
    "delay_node@master",
    "afm_node@slave",
    "controller@slave",
    "controller@master",
    "haptic_node@master",
)
STOP_ORDER = (
    "haptic_node@master",
    "controller@master",
    "controller@slave",
    "afm_node@slave",
    "delay_node@master",
    "recorder@master",
)
_PACKAGE = Path(__file__).resolve().parent
SCENARIO_DIRECTORY = _PACKAGE / "scenarios"
DEFAULT_SITE_FILE = _PACKAGE / "sites" / "local.yaml"


@dataclass(frozen=True)
class UpRequest:
    """What was asked for on the command line."""

    scenario: str
    site_file: Path
    delay_ms: float | None
    duration_s: float | None
    out: Path | None
    overwrite: bool
    settings: Sequence[str]
    without: Sequence[str] = ()


@dataclass(frozen=True)
class Plan:
    """A rig that is known to be sound: its address book, effective scenario and folder."""

    book: SiteBook
    site_file: Path
    loaded: LoadedScenario
    out: Path
    overwrite: bool
    without: frozenset[str] = frozenset()

    @property
    def nodes(self) -> tuple[str, ...]:
        """The nodes to start, in order: all but those that somebody else runs or a recording stands in for."""
        return tuple(node for node in START_ORDER if node not in self.without)

    @property
    def scenario(self) -> Scenario:
        """The effective scenario."""
        return self.loaded.scenario

    @property
    def recording(self) -> Path:
        """The file that the recorder writes."""
        return self.out / RECORDING_NAME

    @property
    def scenario_file(self) -> Path:
        """The file that gives the nodes the effective scenario."""
        return self.out / "scenario.yaml"

    def leftovers(self) -> list[Path]:
        """Give the files of an earlier session in the folder; a recorder that was restarted left several recordings."""
        patterns = ("session*.mcap", "fig12.png", "summary.json")
        return sorted(path for pattern in patterns for path in self.out.glob(pattern))

    def prepare_folder(self) -> None:
        """Make the folder, clear what an earlier session left there if that was asked for, write the scenario."""
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            for old in self.leftovers() if self.overwrite else ():
                old.unlink()
            self.scenario_file.write_text(yaml.safe_dump(self.loaded.document, sort_keys=False), encoding="utf-8")
        except OSError as error:
            raise RigError(f"{self.out}: cannot be written: {error.strerror}") from error


def make_plan(request: UpRequest, default_out: Path) -> Plan:
    """Read and check everything that a rig needs; ConfigError names the file and key at fault."""
    site_file = request.site_file.resolve()
    book = load_site(site_file)
    absent = [node for node in (LAUNCHER, *START_ORDER) if node not in book.nodes]
    if absent:
        raise ConfigError(f"{site_file}: nodes: {', '.join(absent)} is missing, the rig needs an endpoint for each")
    scenario_path = find_scenario(request.scenario)
    out = (request.out or default_out).absolute()
    loaded = effective_scenario(scenario_path, request, out)
    check_sections(loaded)
    plan = Plan(book, site_file, loaded, out, request.overwrite, left_out(request.without))
    recordings = [path for path in plan.leftovers() if path.suffix == ".mcap"]
    if recordings and not request.overwrite:
        raise ConfigError(f"{recordings[0]} exists already: give another --out, or --overwrite to replace it")
    return plan


def left_out(names: Sequence[str]) -> frozenset[str]:
    """Give the nodes meant by `node@site` or `node`; ConfigError names those that there are."""
    for name in names:
        if not any(name in (node, node.partition("@")[0]) for node in START_ORDER):
            raise ConfigError(f"--without {name}: there are {', '.join(START_ORDER)}")
    return frozenset(node for node in START_ORDER if node in names or node.partition("@")[0] in names)


def known_scenarios() -> list[str]:
    """Give the names of the scenarios that come with the project."""
    return sorted(path.stem for path in SCENARIO_DIRECTORY.glob("*.yaml"))


def find_scenario(name: str) -> Path:
    """Give the file of a scenario named or given as a path; ConfigError lists the names known."""
    if name in known_scenarios():
        return SCENARIO_DIRECTORY / f"{name}.yaml"
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.exists():
        return path
    raise ConfigError(f"unknown scenario {name!r}: known are {', '.join(known_scenarios())}, or give a .yaml file")


def effective_scenario(path: Path, request: UpRequest, out: Path) -> LoadedScenario:
    """Lay environment, --set and the other flags over a scenario file; ConfigError names file and key."""
    document, origin = layered(path, request.settings)
    document = anchored(document, path.absolute().parent)
    flags: dict[str, Any] = {}
    if request.duration_s is not None:
        flags["duration_s"] = request.duration_s
        origin += " + --duration"
    if request.delay_ms is not None:
        one_way = {"delay_s": request.delay_ms / 1000.0}
        flags["delay_node"] = {"forward": one_way, "backward": dict(one_way)}
        origin += " + --delay-ms"
    flags["recorder"] = {"directory": str(out), "file_name": RECORDING_NAME}
    document = merge(document, flags)
    return LoadedScenario(validate(Scenario, document, origin), origin, document)


def anchored(tree: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Make the file names in a scenario absolute: they are meant from its folder, the nodes read it from another."""
    return {key: _anchored_value(key, value, folder) for key, value in tree.items()}


def _anchored_value(key: str, value: Any, folder: Path) -> Any:
    if isinstance(value, dict):
        return anchored(value, folder)
    named = isinstance(value, str) and (key == "file" or key.endswith("_file"))
    return str(folder / value) if named else value


def check_sections(loaded: LoadedScenario) -> None:
    """Check every node's section with the node's own model; ConfigError names file and key."""
    for name in sorted({node.partition("@")[0] for node in START_ORDER}):
        loaded.section(name, node_kind(name).config)


def node_kind(name: str) -> NodeKind[Any]:
    """Give the kind that a service declares for itself, so that this check and the node's own cannot differ."""
    module = importlib.import_module(f"services.{name}.__main__")
    return next(value for value in vars(module).values() if isinstance(value, NodeKind))

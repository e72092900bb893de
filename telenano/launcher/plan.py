"""The plan of `telenano up`: nodes, address book and scenario, checked together before any process is started."""

import contextlib
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import yaml
from pydantic import Field

from telenano.analysis.felt_stiffness import SampleFacts
from telenano.devices.afm.capabilities import loop_refusal, refusal
from telenano.launcher.scenario_keys import with_meant
from telenano.recording.session_folder import RECORDING_NAME
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.transports import fetching
from telenano.runtime.loop.realtime import on_one_processor
from telenano.runtime.wiring.main import node_kind
from telenano.sections.afm_section import DRIVERS as INSTRUMENTS
from telenano.sections.afm_section import AfmConfig
from telenano.sections.controller_section import KNOWN_LAWS, ControllerConfig
from telenano.sections.program_table import PROGRAMS
from telenano.sections.sample_section import SampleConfig
from telenano.settings.config import Settings, environment_overrides, flag_overrides, keys_of, merge
from telenano.settings.device_drivers import Drivers
from telenano.settings.included import (
    DEFAULT_SITE_FILE,
    TWO_SITES_FILE,
    anchored,
    find_scenario,
    site_file_named,
)
from telenano.settings.known_packages import KNOWN_MODEL_LAWS, KNOWN_PACKAGES, where_it_is
from telenano.settings.link_files import read_files
from telenano.settings.link_settings import EVEN, LinkSettings, changes_text
from telenano.settings.named_instruments import IDEAL
from telenano.settings.option import Option
from telenano.settings.scenario import LoadedScenario, Scenario, scenario_document
from telenano.wire.errors import ConfigError, RigError, known_names
from telenano.wire.extras import how_to_add_package
from telenano.wire.nodes import (
    FAR_RECORDER,
    JOINED,
    LAUNCHER,
    LINK,
    OPTIONAL_NODES,
    RECORDER,
    SERVICES,
    START_ORDER,
    Site,
    name_of,
    site_of,
)

if TYPE_CHECKING:
    from telenano.recording.recorder_config import RecorderConfig

ATTENDED = ("afm_node.attended=true",)
ALLOW_REPLAY = ("afm_node.allow_replay=true", "haptic_node.allow_replay=true")


class SessionRequest(Settings):
    """A session, live or in virtual time, as a person asks for it."""

    scenario: str = Field(description="Experiment to run: a known name or a YAML file")
    instrument: Annotated[str | None, Option(("--instrument",), "NAME")] = Field(
        default=None,
        description="Named disturbances of the AFM: ideal, real, real_drifting, paper_bridge; default: the scenario's",
    )
    round_trip_ms: Annotated[float | None, Option(("--round-trip-ms",), "D")] = Field(
        default=None, ge=0.0, description="Delay (latency, RTT) of the link, half of it each way [ms]"
    )
    duration_s: float | None = Field(default=None, description="Length of the session [s], instead of the scenario's")
    out: Annotated[Path | None, Option(("--out",), "DIR")] = Field(
        default=None, description="Folder for the results; default: sessions/NAME-DATE-TIME"
    )
    overwrite: Annotated[bool, Option(("--overwrite",))] = Field(
        default=False, description="Replace the results of a session that the folder holds already"
    )
    settings: Annotated[tuple[str, ...], Option(("--set",), "SECTION.KEY=VALUE", tuple, many=True)] = Field(
        default=(), description="Change one key of the scenario (SI units); may be repeated"
    )


class UpRequest(SessionRequest):
    """A session, as `telenano up` is asked for it; without `site` and `attach` the whole rig runs on this machine."""

    scenario: Annotated[str, Option(("--scenario",), "NAME|FILE")] = Field(
        description="Experiment to run: a known name or a YAML file; with --attach it gives name and duration only"
    )
    site_file: Annotated[Path | None, Option(("--site-file",), "FILE", site_file_named)] = Field(
        default=None,
        description="Address book of the rig (YAML); default: all on this machine, with --site two of them",
    )
    site: Site | None = Field(
        default=None, description="Run the nodes of one site here; those of the other run on another machine"
    )
    attach: Annotated[bool, Option(("--attach",))] = Field(
        default=False, description="Start no node: run a session with nodes that were started elsewhere"
    )
    wait_s: float | None = Field(
        default=None, ge=0.0, description="Give up if nodes started elsewhere are not ready after this time [s]"
    )
    without: Annotated[tuple[str, ...], Option(("--without",), "NODE", tuple, many=True)] = Field(
        default=(), description="Leave this node out, so that a replay can take its place (repeatable)"
    )
    allow_replay: Annotated[bool, Option(("--allow-replay",))] = Field(
        default=False, description="Let the devices obey commands that come from a recording"
    )
    attended: Annotated[bool, Option(("--attended",))] = Field(
        default=False, description="A person stands by to retract the tip of an AFM controller without a guard"
    )
    page: bool = Field(default=False, description="Serve the operator's page")


@dataclass(frozen=True)
class Plan:
    """A checked rig: its address book, effective scenario and folder.

    `nodes`: the nodes to start, in order; `others`: the nodes that run elsewhere and that the session needs; `page`:
    whether the operator's page is served too.
    """

    book: AddressBook
    site_file: Path
    loaded: LoadedScenario
    out: Path
    overwrite: bool
    nodes: tuple[str, ...]
    others: tuple[str, ...] = ()
    site: Site | None = None
    attach: bool = False
    wait_s: float | None = None
    page: bool = False
    # The scenario file of the request. With --attach it is used itself, because no effective scenario is written.
    given: Path = Path()

    @property
    def warning(self) -> str:
        """A sentence on scenario keys that override the link's profile, which is easily overlooked; else empty."""
        if LINK not in {name_of(node) for node in self.nodes}:
            return ""
        changes = changes_text(self.loaded.section(LINK, LinkSettings))
        return f"{self.loaded.origin}: {LINK}: {changes}" if changes else ""

    @property
    def stiffness_warning(self) -> str:
        """A sentence on a sample that is too stiff for the law over this instrument and link; else empty."""
        if package_is_absent(self.loaded, "afm_node"):
            return ""
        afm = self.loaded.section("afm_node", AfmConfig)
        controller = self.loaded.section("controller", ControllerConfig)
        stiffness, latency_s = (afm.stiffest_n_per_m, 0.0) if afm.simulated else _declared(afm, self.scenario.period_s)
        even = not self.book.spans_machines and self.loaded.section(LINK, LinkSettings).network_name in EVEN
        return controller.stiffness_doubts(stiffness, latency_s, even=even) if stiffness is not None else ""

    @property
    def sample_facts(self) -> SampleFacts:
        """Properties of the sample according to the scenario, for comparison with the stiffness that the hand feels."""
        try:
            return SampleFacts.of(self.loaded.section("afm_node", AfmConfig))
        except ConfigError:
            # The section may need a package that is installed only at the other site.
            return SampleFacts()

    @property
    def cautions(self) -> tuple[str, ...]:
        """Warnings for the nodes started here whose driver has never been tried with a real device."""
        started = sorted({name_of(node) for node in self.nodes})
        sentences = [
            drivers.caution(getattr(self.scenario, name).get("driver"))
            for name in started
            if not package_is_absent(self.loaded, name) and (drivers := _drivers_of(name)) is not None
        ]
        return tuple(filter(None, sentences))

    @property
    def fetches(self) -> bool:
        """Whether the other site makes a recording of its own, which is fetched after the session."""
        far = self._recorder.far == "fetch" and FAR_RECORDER in self.book.nodes
        return self.site == "master" and not self.attach and self.book.spans_machines and far

    @property
    def fetch_kbit_per_s(self) -> float:
        """Greatest data rate of the fetch after a session [kbit/s]."""
        return self._recorder.fetch_kbit_per_s

    @property
    def _recorder(self) -> "RecorderConfig":
        # The import is late because containers of nodes use this module and have no writer of recordings.
        from telenano.recording.recorder_config import RecorderConfig

        return self.loaded.section("recorder", RecorderConfig)

    @property
    def joined(self) -> dict[str, tuple[str, ...]]:
        """The processes that run several nodes, by name, each with its nodes in the order in which they are built.

        The node of a real device has its own process, so that it still holds and retracts if another node hangs.
        """
        if self.scenario.realtime.processes == "node":
            return {}
        found = {
            process: tuple(node for node in nodes if node in self.nodes and self._may_be_joined(node))
            for process, nodes in JOINED.items()
        }
        return {process: nodes for process, nodes in found.items() if len(nodes) > 1}

    def _may_be_joined(self, node: str) -> bool:
        kind = node_kind(name_of(node))
        return bool(getattr(self.loaded.section(kind.name, kind.config), "simulated", True))

    @property
    def launcher(self) -> str:
        return f"launcher@{self.site or 'master'}"

    @property
    def scenario(self) -> Scenario:
        return self.loaded.scenario

    @property
    def recording(self) -> Path:
        return self.out / RECORDING_NAME

    @property
    def scenario_file(self) -> Path:
        return self.given if self.attach else self.out / "scenario.yaml"

    @property
    def scenario_bytes(self) -> bytes:
        """The effective scenario as YAML, with environment and flags merged, which the nodes read."""
        return yaml.safe_dump(self.loaded.document, sort_keys=False).encode()

    def existing_outputs(self) -> list[Path]:
        """Return the sorted files of an earlier session in the folder; a restarted recorder leaves several files."""
        # With --attach, a recorder of another launcher may be writing to this folder.
        recordings = () if self.attach else ("session*.mcap",)
        patterns = (*recordings, "fig12.png", "fig12.pdf", "fig12.svg", "summary.json")
        far = () if self.attach else ("far.json", "far/*", "both.mcap")
        return sorted(path for pattern in (*patterns, *far) for path in self.out.glob(pattern))

    def prepare_folder(self) -> None:
        """Create the folder, delete the files of an earlier session if `overwrite`, and write the scenario.

        Raises:
            RigError: The folder cannot be written.
        """
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            for old in self.existing_outputs() if self.overwrite else ():
                old.unlink()
            if not self.attach:
                self.scenario_file.write_bytes(self.scenario_bytes)
        except OSError as error:
            raise RigError(f"{self.out}: cannot be written: {error.strerror}") from error

    def remake_folder(self) -> None:
        """Restore the folder and its scenario file if they were removed; an OSError, such as a full disk, is ignored.

        Only people need them: restarted nodes read copies that the launcher holds open.
        """
        with contextlib.suppress(OSError):
            self.out.mkdir(parents=True, exist_ok=True)
            if not self.attach and not self.scenario_file.exists():
                self.scenario_file.write_bytes(self.scenario_bytes)


def _declared(afm: AfmConfig, period_s: float) -> tuple[float | None, float]:
    """Return the greatest stiffness [N/m] that a real instrument can feel, and its latency [s], from its calibration.

    The stiffness is that of the cantilever, because no sample feels stiffer. It is None if the driver or its
    calibration file cannot be used: the file may be on another machine, and the instrument's node reports the fault.
    """
    from telenano.devices.afm.instrument import driver_of

    package = INSTRUMENTS.find(afm.driver)
    try:
        driver = driver_of(afm, period_s) if package is None or package.calibration is not None else None
    except ConfigError:
        return None, 0.0
    cantilever = getattr(getattr(driver, "calibration", None), "cantilever", None)
    return getattr(cantilever, "stiffness_n_per_m", None), getattr(driver, "latency_s", 0.0)


def make_plan(request: UpRequest, default_out: Path) -> Plan:
    """Read and check site file, scenario and outputs of a rig; ConfigError names the file and key at fault.

    `default_out` is the folder of the session if the request names none.
    """
    named = request.site_file or (DEFAULT_SITE_FILE if request.site is None else TWO_SITES_FILE)
    # `Path.resolve` raises RuntimeError for a loop of symbolic links; `realpath` does not.
    site_file = Path(os.path.realpath(named)) if named.exists() else named.absolute()
    book = AddressBook.load(site_file)
    own = own_nodes(book, request)
    check_book(book, site_file, request)
    out = (request.out or default_out).absolute()
    scenario_path = find_scenario(request.scenario).absolute()
    elsewhere = {name_of(node) for node in other_nodes(request)} - {name_of(node) for node in own}
    try:
        loaded = effective_scenario(scenario_path, request, out)
        check_sections(loaded, elsewhere)
    except ConfigError as error:
        raise ConfigError(*map(with_meant, error.lines)) from error
    check_files(loaded, elsewhere)
    if not request.attach and request.site != "slave":
        _check_delay(loaded)
    plan = Plan(
        book=book,
        site_file=site_file,
        loaded=loaded,
        out=out,
        overwrite=request.overwrite,
        nodes=own,
        others=other_nodes(request),
        site=request.site,
        attach=request.attach,
        wait_s=request.wait_s,
        page=request.page and request.site != "slave",
        given=scenario_path,
    )
    for nodes in plan.joined.values():
        try:
            on_one_processor(plan.scenario.realtime_in_force(), nodes, nodes[-1])
        except ConfigError as error:
            raise ConfigError(f"{loaded.origin}: {error}") from error
    if plan.fetches and fetching() is None:
        package = KNOWN_PACKAGES["command bag fetch"]
        text = f"to fetch is in the package {package}: {how_to_add_package(package)}; `stream` needs none"
        raise ConfigError(f"{loaded.origin}: recorder.far: {text}")
    existing = [path for path in plan.existing_outputs() if plan.attach or path.suffix == ".mcap"]
    if existing and not request.overwrite:
        raise ConfigError(f"{existing[0]} exists already: give another --out, or --overwrite to replace it")
    return plan


def _check_delay(loaded: LoadedScenario) -> None:
    """Raise ConfigError if the round trip of the link is at least as long as the session: no answer would arrive."""
    link = loaded.section("delay_node", LinkSettings)
    there_s, back_s, lasts_s = link.forward.delay_s, link.backward.delay_s, loaded.scenario.duration_s
    if lasts_s is not None and there_s + back_s >= lasts_s:
        raise ConfigError(
            f"{loaded.origin}: the link delays by {there_s:g} s there and {back_s:g} s back, and the session lasts "
            f"{lasts_s:g} s: no answer would arrive; give a greater duration_s, or smaller delays"
        )


def own_nodes(book: AddressBook, request: UpRequest) -> tuple[str, ...]:
    """Return the nodes to start, in order: all except those that run elsewhere or that --without leaves out."""
    if request.attach:
        return ()
    names: tuple[str, ...] = START_ORDER
    if request.site is not None:
        optional = [node for node in OPTIONAL_NODES if node in book.nodes]
        names = tuple(node for node in (*optional, *START_ORDER) if site_of(node) == request.site)
    excluded = excluded_nodes(request.without, names)
    return tuple(node for node in names if node not in excluded)


def other_nodes(request: UpRequest) -> tuple[str, ...]:
    """Return the nodes that run elsewhere and that the session needs, in the order in which a rig is shown."""
    if request.attach:
        return tuple(node for node in START_ORDER if node != RECORDER)
    if request.site == "master":
        return tuple(node for node in START_ORDER if site_of(node) == "slave")
    return ()


def check_book(book: AddressBook, site_file: Path, request: UpRequest) -> None:
    """Raise ConfigError naming the nodes that a site file lacks."""
    needed = [LAUNCHER, *(node for node in START_ORDER if not (request.attach and node == RECORDER))]
    if request.site is not None:
        # The nodes at the slave's site connect to the link's endpoint there.
        needed += [f"launcher@{request.site}", f"{LINK}@slave"]
    absent = [node for node in dict.fromkeys(needed) if node not in book.nodes]
    if absent:
        raise ConfigError(f"{site_file}: nodes: {', '.join(absent)} is missing, the rig needs an endpoint for each")


def excluded_nodes(names: Sequence[str], nodes: Sequence[str] = START_ORDER) -> frozenset[str]:
    """Return the nodes named by `node@site` or `node`; ConfigError for an unknown name lists the known ones."""
    for name in names:
        if not any(name in (node, name_of(node)) for node in nodes):
            raise ConfigError(f"--without {name}: no such node, {known_names(name, nodes)}")
    return frozenset(node for node in nodes if node in names or name_of(node) in names)


def effective_scenario(path: Path, request: UpRequest, out: Path) -> LoadedScenario:
    """Merge environment, --set and the other flags into a scenario; ConfigError names file and key."""
    settings = [*request.settings, *(ALLOW_REPLAY if request.allow_replay else ())]
    settings += ATTENDED if request.attended else ()
    settings += [f"instrument={request.instrument}"] if request.instrument is not None else ()
    document, origin = scenario_document(path, settings)
    document = anchored(document, path.absolute().parent)
    flags: dict[str, Any] = {}
    if request.duration_s is not None:
        flags["duration_s"] = request.duration_s
        origin += " + --duration"
    if request.round_trip_ms is not None:
        one_way = {"delay_s": 0.5e-3 * request.round_trip_ms}
        flags["delay_node"] = {"forward": one_way, "backward": dict(one_way)}
        origin += " + --round-trip-ms"
    if not request.attach:
        _reject_recording_place(settings)
        flags["recorder"] = {"directory": str(out), "file_name": RECORDING_NAME}
        if request.site is not None:
            # Each of the two launchers has a recorder if the site file has one for its site.
            far = "stream" if fetching() is None else "fetch"
            flags["recorder"]["far"] = (document.get("recorder") or {}).get("far", far)
    if refused := refused_laws(str((document.get("afm_node") or {}).get("driver", "simulated"))):
        # Both halves use these texts to refuse a later change of law, so that the reason is the same as here.
        flags["controller"] = {"refused_laws": refused}
    document = merge(document, flags)
    return LoadedScenario.of(document, origin)


def refused_laws(driver: str) -> dict[str, str]:
    """Return the laws that cannot be used with a driver of the instrument, each with the reason."""
    instead = dict.fromkeys((*KNOWN_MODEL_LAWS, *(name for name, law in KNOWN_LAWS.items() if not law.link_loop)))
    where = next((where_it_is(f"law {name}") for name in KNOWN_MODEL_LAWS if name not in KNOWN_LAWS), "")
    closing = [name for name, law in KNOWN_LAWS.items() if law.link_loop]
    return {name: text for name in closing if (text := loop_refusal(driver, name, instead, where))}


def _reject_recording_place(settings: Sequence[str]) -> None:
    """Reject the recorder's folder and file name in --set and environment, because --out determines them.

    In a scenario they are allowed, because they apply to a recorder that is started alone.
    """
    for origin, settings_of in (("--set", flag_overrides(settings)), ("environment", environment_overrides())):
        section = settings_of.get("recorder")
        keys = [key for key in ("directory", "file_name") if isinstance(section, dict) and key in section]
        if keys:
            raise ConfigError(
                f"{origin}: recorder.{keys[0]}: `telenano up` records to {RECORDING_NAME} in the folder of --out: "
                "give that option"
            )


def check_files(loaded: LoadedScenario, elsewhere: Collection[str] = ()) -> None:
    """Raise ConfigError for the first file of the scenario that a node of this machine cannot use.

    `elsewhere`: names of the nodes that run on other machines, whose files are not checked.
    """
    if "delay_node" not in elsewhere:
        for way in ("forward", "backward"):
            link = loaded.section("delay_node", LinkSettings)
            read_files(getattr(link, way), Path(), f"{loaded.origin}: delay_node.{way}")
    sample = None if "afm_node" in elsewhere else loaded.section("afm_node", AfmConfig).sample
    if sample is not None and sample.is_file and not Path(sample.name).is_file():
        raise ConfigError(f"{loaded.origin}: afm_node.sample.name: {sample.name} is neither a file nor a known shape")
    if sample is not None and sample.map is not None and sample.map_span is None:
        try:
            loaded.section("afm_node", AfmConfig).to_over_map()
        except ConfigError as error:
            raise ConfigError(f"{loaded.origin}: afm_node.sample.map: {error}") from error


def _drivers_of(name: str) -> Drivers | None:
    """Return the drivers of the device of a node; None for a node without a device."""
    from telenano.sections.hand_section import DRIVERS as HANDLES

    return {"afm_node": INSTRUMENTS, "haptic_node": HANDLES}.get(name)


def package_is_absent(loaded: LoadedScenario, name: str) -> bool:
    """Return whether a driver, a layer or a program that a node's section names is in no package on this machine."""
    if (drivers := _drivers_of(name)) is None:
        return False
    section = getattr(loaded.scenario, name)
    layers = (section.get("sample") or {}).keys() - keys_of(SampleConfig).keys()
    program = (section.get("begin") or {}).get("program")
    absent = any(where_it_is(f"layer {layer}") for layer in layers)
    absent |= program not in PROGRAMS and bool(where_it_is(f"program {program}"))
    return absent or drivers.is_absent(section.get("driver"))


def check_sections(loaded: LoadedScenario, elsewhere: Collection[str] = ()) -> None:
    """Check every node's section with the node's own model; ConfigError names file and key.

    A law or a program that does not work with the instrument's driver is refused as well.

    Args:
        loaded: The scenario.
        elsewhere: The names of the nodes that run on other machines. The section of one whose driver's package is not
            on this machine is not checked here: the node checks it itself.
    """
    absent = {name for name in elsewhere if package_is_absent(loaded, name)}
    for name in SERVICES:
        if name not in absent:
            loaded.section(name, node_kind(name).config)
    if "afm_node" in absent:
        return
    afm, law = loaded.section("afm_node", AfmConfig), loaded.section("controller", ControllerConfig).law
    if loaded.scenario.instrument != IDEAL and afm.driver != "simulated":
        text = f"{loaded.scenario.instrument} disturbs a simulated AFM only, and afm_node.driver is {afm.driver}"
        raise ConfigError(
            f"{loaded.origin}: instrument: {text}, which has disturbances of its own: leave `instrument` out"
        )
    program = "" if afm.begin is None else afm.begin.program or ""
    if text := refused_laws(afm.driver).get(law) or refusal(afm.driver, program):
        raise ConfigError(f"{loaded.origin}: {text}")

"""The scenario file: one section a node; the supervisor reads all of it, each node its own section."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeGuard, TypeVar

from pydantic import BaseModel, Field, model_validator

from telenano.settings.config import Settings, layered, parse_yaml, validate
from telenano.settings.included import name_of_scenario
from telenano.settings.named_instruments import IDEAL, on_instrument
from telenano.settings.plugins import name_of_ending
from telenano.wire.errors import RecordingError

M = TypeVar("M", bound=BaseModel)
# The keys that the seed of a session sets: those of the link and of all disturbances.
SEEDS = ("delay_node.seed", "haptic_node.disturbances.seed", "afm_node.disturbances.seed")


class RealtimeConfig(Settings):
    """Real-time settings to request; `auto` uses what is permitted and logs once what is not."""

    scheduler: Literal["auto", "fifo", "normal"] = Field(
        default="auto", description="fifo: SCHED_FIFO or an error; auto: where permitted; normal: never"
    )
    priority: Annotated[int, Field(ge=1, le=98)] = Field(default=50, description="Priority under SCHED_FIFO")
    memory_lock: Literal["auto", "on", "off"] = Field(default="auto", description="Lock the memory of the process")
    cpus: Literal["auto", "link_at_master", "free"] | dict[str, Annotated[int, Field(ge=0)]] = Field(
        default="auto",
        description="Processor on which a process stays. auto: under SCHED_FIFO the master's nodes on one, link and "
        "slave's nodes on another; link_at_master: the link with the master's nodes, which auto chooses where the AFM "
        "has model dynamic; free: any; or a mapping of node or node@site to a processor",
    )
    rate_hz: Annotated[float, Field(ge=50.0, le=10_000.0)] = Field(
        default=1000.0,
        description="Rate of hand, instrument, law and devices [Hz]; docs/performance.md has the rates that machines "
        "reach",
    )
    processes: Literal["node", "site"] = Field(
        default="node",
        description="node: each node has a process of its own; site: hand, its half and the link share one, and the "
        "AFM and its half another one, which makes the loop younger; a real device keeps its own",
    )
    huge_pages: bool = Field(
        default=True, description="Put the memory of each process on pages of 2 MB at its start, where the kernel can"
    )


class Scenario(Settings):
    """An experiment: what runs, for how long, and the section of each node, which the node itself checks."""

    name: str = Field(pattern=r"^[a-z0-9_-]{1,64}$", description="Name of the experiment, used for files")
    description: str = Field(description="Sentence on what the experiment shows")
    duration_s: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(description="Length of the session [s]")
    instrument: str = Field(
        default=IDEAL,
        description="Named disturbances that the keys below change: ideal, real, real_drifting, or the name of a file "
        "in the folder TELENANO_INSTRUMENTS",
    )
    realtime: RealtimeConfig = Field(
        default=RealtimeConfig(), description="Rate, scheduling and memory of the processes"
    )
    haptic_node: dict[str, Any] = Field(default={}, description="Section of the haptic node")
    controller: dict[str, Any] = Field(default={}, description="Section of both halves of the law")
    delay_node: dict[str, Any] = Field(default={}, description="Section of the link")
    afm_node: dict[str, Any] = Field(default={}, description="Section of the AFM")
    recorder: dict[str, Any] = Field(default={}, description="Section of the recorder")
    viz_node: dict[str, Any] = Field(default={}, description="Section of the server of the page")

    @model_validator(mode="after")
    def _check_rate(self) -> Self:
        period_s = self.controller.get("period_s")
        rate_hz = self.realtime.rate_hz
        if (
            "rate_hz" in self.realtime.model_fields_set
            and _is_number(period_s)
            and abs(period_s * rate_hz - 1.0) > 1e-6
        ):
            text = f"realtime.rate_hz: {rate_hz:g} and controller.period_s: {period_s:g} disagree"
            raise ValueError(f"{text}: give realtime.rate_hz alone")
        return self

    @property
    def period_s(self) -> float:
        """Period of the loop [s], in whole nanoseconds: that of `realtime.rate_hz`, or the one that the law gives."""
        period = self.controller.get("period_s")
        return float(period) if _is_number(period) else round(1e9 / self.realtime.rate_hz) / 1e9

    @property
    def controller_in_force(self) -> dict[str, Any]:
        """The section of both halves of the law: its period is that of the loop, its hand that of the haptic node."""
        guard, given = self.haptic_node.get("limits"), self.controller.get("hand_limits")
        own = {key: guard[key] for key in _OF_HAND if key in guard} if isinstance(guard, Mapping) else {}
        # A section that is no mapping is refused by its own model.
        limits = {**own, **given} if isinstance(given, Mapping) else own if given is None else given
        return {**self.controller, "period_s": self.controller.get("period_s", self.period_s), "hand_limits": limits}

    def realtime_in_force(self) -> RealtimeConfig:
        """Return the real-time settings that the nodes ask for, with the processors that `auto` means.

        The dynamic cantilever takes a seventh of the slave's processor. With link, controller and instrument on that
        processor the loop was half a millisecond slower; with the link on the other processor it was not.
        """
        busy = self.afm_node.get("model") == "dynamic" and self.realtime.cpus == "auto"
        return self.realtime.model_copy(update={"cpus": "link_at_master"}) if busy else self.realtime


# The keys of `haptic_node.limits` that bound the references of a law too.
_OF_HAND = ("position_min_m", "position_max_m", "max_speed_m_per_s")


def _is_number(value: object) -> TypeGuard[float]:
    """Return whether a value that its section has not validated yet can be a period: a finite number above 0."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) and value > 0.0


# The keys by which a scenario may name an entry of a package, each with the kind of the entry
# (`telenano.settings.plugins`).
_NAMED = (
    ("laws", ("controller", "law")),
    ("devices", ("haptic_node", "driver")),
    ("devices", ("afm_node", "driver")),
    ("operators", ("haptic_node", "operator", "kind")),
    ("samples", ("afm_node", "environment")),
    ("programs", ("afm_node", "begin", "program")),
    ("readers", ("afm_node", "sample", "name")),
    ("readers", ("afm_node", "sample", "map")),
)
_LAYERS = ("afm_node", "sample")


def named_in(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return kind and name of each law, device, operator, sample, layer, reader and program that a scenario names."""
    named = ((kind, _at(document, path)) for kind, path in _NAMED)
    # A scenario names the file; the entry that reads it is named after the file's suffix.
    texts = [(kind, value) for kind, value in named if isinstance(value, str)]
    found = [(kind, name_of_ending(value) if kind == "readers" else value) for kind, value in texts]
    sample = _at(document, _LAYERS)
    sections = sample.items() if isinstance(sample, Mapping) else ()
    found = [(kind, name) for kind, name in found if name]
    return found + [("samples", name) for name, section in sections if isinstance(section, Mapping)]


def _at(document: Any, path: Sequence[str]) -> Any:
    for key in path:
        document = document.get(key) if isinstance(document, Mapping) else None
    return document


@dataclass(frozen=True)
class LoadedScenario:
    """A scenario, where it was read from, and the merged document."""

    scenario: Scenario
    origin: str
    document: dict[str, Any]

    def section(self, name: str, model: type[M]) -> M:
        """Return a node's section, validated; ConfigError names file and key."""
        of_law = name == "controller" and "period_s" in model.model_fields
        section = self.scenario.controller_in_force if of_law else getattr(self.scenario, name)
        return validate(model, section, self.origin, name)

    @classmethod
    def of(cls, document: Mapping[str, Any], origin: str, *, is_whole: bool = False) -> "LoadedScenario":
        """Validate a document that was read already as a scenario, merged over the keys of its instrument.

        Args:
            document: The scenario.
            origin: The source that an error names.
            is_whole: Whether the document already has the keys of its instrument, as in a recording; the instrument of
                the same name on this machine is then ignored.

        Raises:
            ConfigError: A key is wrong; the message names `origin` and the key.
        """
        whole = dict(document) if is_whole else on_instrument(document)
        return cls(validate(Scenario, whole, origin), origin, whole)

    @classmethod
    def attached(cls, path: Path, attachments: Mapping[str, bytes]) -> "LoadedScenario":
        """Return the scenario that is attached to a recording.

        Args:
            path: The recording, which an error names.
            attachments: The attachments of the recording by file name.

        Raises:
            RecordingError: No scenario is attached.
            ConfigError: A key of it is wrong.
        """
        if (content := attachments.get("scenario.yaml")) is None:
            raise RecordingError(f"{path}: has no scenario attached, so its scales are unknown")
        origin = f"{path}: scenario.yaml"
        return cls.of(parse_yaml(content, origin), origin, is_whole=True)

    @classmethod
    def load(cls, path: Path, flags: Sequence[str] = ()) -> "LoadedScenario":
        """Read a scenario with environment and flags merged over it; ConfigError names file and key."""
        return cls.of(*scenario_document(path, flags))


def scenario_document(path: Path, flags: Sequence[str] = ()) -> tuple[dict[str, Any], str]:
    """Return a scenario with environment and flags merged over it, not yet validated, and where it is from.

    `haptic_node.device=NAME` is read as the driver of that name: the section describes the simulated device alone.
    """
    document, origin = layered(path, flags)
    origin = origin.replace(str(path), name_of_scenario(path), 1)
    hand = document.get("haptic_node")
    if isinstance(hand, dict) and isinstance(hand.get("device"), str):
        hand = {**hand, "driver": hand["device"]}
        document["haptic_node"] = {key: value for key, value in hand.items() if key != "device"}
    return document, origin

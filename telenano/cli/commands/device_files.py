"""Helpers shared by the commands of `telenano device`: sections of scenarios, and the scheduling of a device."""

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel

from telenano.settings.included import find_scenario

Section = TypeVar("Section", bound=BaseModel)


def run_ahead() -> None:
    """Request the scheduling of the nodes for this process, because a real device must be served in time."""
    from telenano.runtime.loop.log import StructuredLog, configure_logging
    from telenano.runtime.loop.realtime import apply_realtime, freeze_garbage
    from telenano.settings.scenario import RealtimeConfig

    configure_logging()
    apply_realtime(RealtimeConfig(cpus="free"), StructuredLog("device"), "device")
    freeze_garbage(disable=False)


def section_of(scenario: Path | None, name: str, model: type[Section]) -> Section:
    """Return a section of a scenario (a name or a file), or its defaults; ConfigError says what is wrong."""
    from telenano.settings.scenario import LoadedScenario

    return model() if scenario is None else LoadedScenario.load(find_scenario(str(scenario))).section(name, model)

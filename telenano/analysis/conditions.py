"""Conditions of a session, as its recording states them: law, parameters, delay, link and versions."""

from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.analysis.plugins import recorded_plugins, require_installed
from telenano.recording.messages import readable
from telenano.recording.multi_file import RecordingSource
from telenano.recording.site_clock import Timeline
from telenano.sections.controller_section import ControllerConfig
from telenano.settings.afm_disturbances import instrument_name
from telenano.settings.config import validate
from telenano.settings.link_settings import EVEN, LinkSettings
from telenano.settings.named_instruments import IDEAL
from telenano.settings.scenario import Scenario
from telenano.wire.nodes import LAUNCHER, LINK, name_of

_MASTER = "controller@master"
# A round trip counts as changed if it varies by more than this [ms], and by more than _CHANGED_SHARE of its median.
_CHANGED_MS = 10.0
_CHANGED_SHARE = 0.5


def conditions(
    recording: RecordingSource, scenario: Scenario, start_ns: int, end_ns: int, timeline: Timeline | None = None
) -> dict[str, Any]:
    """Return the conditions that a figure or a table must state beside its numbers.

    Args:
        recording: The recording of the session.
        scenario: The scenario that is attached to the recording.
        start_ns: The start of the session by the master's clock [ns].
        end_ns: The end of the session by the master's clock [ns].
        timeline: The clocks of the recording; None reads them from it.

    Returns:
        `law`, the laws in the order in which they were in force; `parameters` of the law that the scenario names;
        `changed`, settings changed during the session; `outside_of_shown`, warnings that the session left the range
        for which its law was shown to hold, if there were any; `link_round_trip_ms`, median of the delays that the
        link added there and back, and `link_round_trip_range_ms`, the least and the greatest of them;
        `loop_round_trip_ms`, median age, in whole periods, of the sample that the newest answer descends from, which
        the law has to bridge (both null where nothing was recorded); name of the network and seed of the link;
        `instrument`, name of the set of disturbances of the AFM; `plugins`, package, version and digest of each entry
        that comes from another package; versions.

    Raises:
        ConfigError: A section of the scenario cannot be read, or needs a package; the message names it.
    """
    origin = f"{recording.path}: scenario.yaml"
    plugins = recorded_plugins(recording, scenario.model_dump())
    require_installed({key: facts for key, facts in plugins.items() if key.startswith("laws.")})
    controller = validate(ControllerConfig, scenario.controller_in_force, origin, "controller")
    link = validate(LinkSettings, scenario.delay_node, origin, LINK)
    timeline = timeline or Timeline(recording)
    laws, loop_ms = _law_status(recording, start_ns, end_ns)
    outside = _outside(recording, timeline, start_ns, end_ns)
    versions = recording.metadata.get("versions", {})
    trips_ms = _link_round_trips_ms(recording, start_ns, end_ns)
    return {
        "law": laws or [controller.law],
        "parameters": controller.law_config().model_dump(mode="json"),
        "changed": _changed(recording, timeline, start_ns, end_ns),
        **({"outside_of_shown": outside} if outside else {}),
        "link_round_trip_ms": None if trips_ms is None else round(float(np.median(trips_ms)), 3),
        "link_round_trip_range_ms": None if trips_ms is None else _range(trips_ms),
        "loop_round_trip_ms": loop_ms,
        "link_profile": link.network_name,
        "link_seed": link.seed,
        "instrument": instrument_name(scenario.instrument, scenario.afm_node),
        "plugins": plugins,
        "version": versions.get("package telenano", "unknown"),
        "commit": versions.get("commit", "unknown"),
    }


def title(conditions: dict[str, Any]) -> str:
    """Return the conditions as a title: law, round trip, and the network and the instrument if they are not ideal."""
    words = [" then ".join(conditions["law"])]
    least_ms, greatest_ms = conditions.get("link_round_trip_range_ms") or (0.0, 0.0)
    for key, name in (
        ("link_round_trip_ms", "round trip of the link"),
        ("loop_round_trip_ms", "round trip of the loop"),
    ):
        if conditions[key] is None:
            continue
        # The median does not describe a delay that was changed in the session, so the range is shown.
        is_changed = name.endswith("link") and greatest_ms - least_ms > max(
            _CHANGED_MS, _CHANGED_SHARE * conditions[key]
        )
        words.append(f"{name} {least_ms:g} to {greatest_ms:g} ms" if is_changed else f"{name} {conditions[key]:g} ms")
        break
    if conditions["link_profile"] not in EVEN:
        words.append(f"link {conditions['link_profile']}")
    if conditions.get("instrument", IDEAL) != IDEAL:
        words.append(f"instrument {conditions['instrument']}")
    return ", ".join(words)


def described(scenario: str, conditions: dict[str, Any]) -> str:
    """Return all conditions in words, for the metadata of a figure's file: a figure for a paper has no title."""
    parameters = ", ".join(f"{key}={value}" for key, value in conditions["parameters"].items())
    return (
        f"{scenario}, {title(conditions)}; parameters: {parameters}; "
        f"changed: {', '.join(conditions['changed']) or 'nothing'}; "
        f"network {conditions['link_profile']}, seed {conditions['link_seed']}; "
        f"telenano {conditions['version']}, commit {conditions['commit']}"
    )


def _law_status(recording: RecordingSource, start_ns: int, end_ns: int) -> tuple[list[str], float | None]:
    status = _law_columns(recording, start_ns, end_ns)
    if status is None:
        return [], None
    round_trips_s = status["round_trip_s"][status["round_trip_valid"].astype(bool)]
    laws = [law for _, law in _in_turn(status, start_ns)]
    return laws, round(1e3 * float(np.median(round_trips_s)), 3) if round_trips_s.size else None


def laws_in_turn(recording: RecordingSource, start_ns: int, end_ns: int) -> list[tuple[float, str]]:
    """Return each law that was in force in the master's half, with its start in session time [s]."""
    status = _law_columns(recording, start_ns, end_ns)
    return [] if status is None else _in_turn(status, start_ns)


def _law_columns(recording: RecordingSource, start_ns: int, end_ns: int) -> dict[str, npt.NDArray[Any]] | None:
    """Return the columns of law/status from the master's half during the session; None if none is recorded."""
    if not any(channel.channel_topic == "law/status" for channel in recording.channels):
        return None
    status = recording.columns("law/status", ("t_ns", "src", "law", "round_trip_s", "round_trip_valid"))
    inside = (status["src"] == _MASTER) & (status["t_ns"] >= start_ns) & (status["t_ns"] <= end_ns)
    return {name: values[inside] for name, values in status.items()}


def _in_turn(status: dict[str, npt.NDArray[Any]], start_ns: int) -> list[tuple[float, str]]:
    laws = [str(law) for law in status["law"]]
    times_s = (1e-9 * (status["t_ns"] - start_ns)).tolist()
    turns = [(at, law) for at, law, before in zip(times_s, laws, ["", *laws], strict=False) if law != before]
    # The first law counts from 0, because its first report comes some time after its start.
    return [(0.0 if place == 0 else at, law) for place, (at, law) in enumerate(turns)]


def _link_round_trips_ms(recording: RecordingSource, start_ns: int, end_ns: int) -> npt.NDArray[np.float64] | None:
    """Return the delays that the link added there and back [ms], each a mean over 0.1 s; None if none is known."""
    if not any(channel.channel_topic == "link/status" for channel in recording.channels):
        return None
    ways = [(f"{way}.delay_mean_s", f"{way}.delay_valid") for way in ("forward", "backward")]
    status = recording.columns("link/status", ("t_ns", *(name for way in ways for name in way)))
    inside = (status["t_ns"] >= start_ns) & (status["t_ns"] <= end_ns)
    for _, valid in ways:
        inside &= status[valid].astype(bool)
    if not inside.any():
        return None
    there, back = (status[mean_s][inside] for mean_s, _ in ways)
    return np.asarray(1e3 * (there + back), dtype=np.float64)


def _range(values: npt.NDArray[np.float64]) -> list[float]:
    return [round(float(values.min()), 3), round(float(values.max()), 3)]


def _changed(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[str]:
    """Return the acknowledgements of settings changed during the session, each with the name of its node."""
    events = recording.select(lambda channel: channel.topic == "session/event" and channel.via == "direct")
    texts = []
    for event, fields in readable(events, recording.left_out):
        text = fields["text"]
        if fields["kind"] != "ack" or not text.startswith("set "):
            continue
        if timeline.stamp_ns(event.src, start_ns) <= event.publish_ns <= timeline.stamp_ns(event.src, end_ns):
            texts.append(f"{event.src}: {text}")
    return texts


def _outside(recording: RecordingSource, timeline: Timeline, start_ns: int, end_ns: int) -> list[dict[str, Any]]:
    """Return warnings that the session left the range for which its law was shown to hold, in session time [s]."""
    events = recording.select(
        lambda channel: channel.topic == "session/event" and name_of(channel.src) == name_of(LAUNCHER)
    )
    # A warning from the other site may be recorded twice: where it was sent, and where it arrived.
    by_key: dict[tuple[str, int], dict[str, Any]] = {}
    for event, fields in readable(events, recording.left_out):
        axis, law = fields["data"].get("outside"), fields["data"].get("law")
        if not isinstance(axis, str) or not isinstance(law, str):
            continue
        at_ns = timeline.time_ns(event)
        if start_ns <= at_ns <= end_ns:
            time_s = round(1e-9 * (at_ns - start_ns), 3)
            row = {"time_s": time_s, "law": law, "axis": axis, "text": fields["text"]}
            by_key.setdefault((event.src, event.publish_ns), row)
    return sorted(by_key.values(), key=lambda row: row["time_s"])

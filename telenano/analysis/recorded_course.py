"""Columns and conditions of a recorded session, under the same names as those of a simulated one."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.recorded_session import Session
from telenano.analysis.session import COLUMNS, Conditions, hand_in_words, sample_in_words
from telenano.recording.column_table import Column, ColumnTable
from telenano.recording.messages import readable
from telenano.recording.multi_file import RecordingSource
from telenano.recording.silence import LONGEST_STEP_S
from telenano.settings.afm_disturbances import instrument_name
from telenano.settings.config import validate
from telenano.settings.link_settings import LinkSettings
from telenano.settings.scenario import LoadedScenario
from telenano.wire.nodes import LINK, name_of

Series = npt.NDArray[np.float64]


def course_of(session: Session) -> ColumnTable:
    """Return a column for each name of `COLUMNS`, one value per sample of the hand while its force profile ran.

    A value from another process is the newest one at the time of the hand's sample. If that is older than 50 ms, a
    number is NaN, and a truth value False.
    """
    series = session.series()
    time_s = series.hand_time_s
    tip = _Newest(series.tip_time_s, time_s)
    command = _Newest(series.reference_time_s, time_s)
    values: dict[str, Column] = {
        "time_s": time_s,
        "operator_force_n": series.hand_force_n,
        "hand_position_m": series.hand_position_m,
        "reference_m": command.numbers(series.reference_m),
        "rendered_force_n": command.numbers(session.command["force_n.2"]),
        "base_position_m": tip.numbers(-session.tip["base_position_m.2"]),
        "tip_force_n": tip.numbers(series.tip_force_n),
        "scaled_tip_force_n": tip.numbers(series.force_scale * series.tip_force_n),
        "separation_m": tip.numbers(series.separation_m),
        "in_contact": tip.flags(session.touches()),
        "hand_following": np.asarray(session.hand["mode"] != "off", dtype=np.bool_),
    }
    units = {name: unit for name, (unit, _) in COLUMNS.items()}
    return ColumnTable("a recorded session", values, units, {name: text for name, (_, text) in COLUMNS.items()})


class _Newest:
    """The newest sample of another series at each time of a series, if it is no older than LONGEST_STEP_S."""

    def __init__(self, own_s: Series, time_s: Series) -> None:
        self._places = np.searchsorted(own_s, time_s, side="right") - 1
        self._fresh = self._places >= 0
        self._fresh[self._fresh] = (
            (time_s - own_s[self._places])[self._fresh] <= LONGEST_STEP_S if own_s.size else False
        )

    def numbers(self, values: Series) -> Series:
        found = np.full(self._fresh.size, np.nan)
        found[self._fresh] = values[self._places[self._fresh]]
        return found

    def flags(self, values: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        found = np.zeros(self._fresh.size, dtype=np.bool_)
        found[self._fresh] = values[self._places[self._fresh]]
        return found


def conditions_of(recording: RecordingSource, session: Session) -> Conditions:
    """Return the settings of a recorded session.

    Law and parameters are those of its summary. Delay and network are those that the link reported at the start of the
    session, because they may have been set after the start of the rig; without such a report, those of the scenario.

    Raises:
        RecordingError: No scenario is attached.
        ConfigError: A key of the scenario is wrong; the message names it.
    """
    facts = session.conditions
    scenario = LoadedScenario.attached(recording.path, recording.attachments).scenario
    origin = f"{recording.path}: scenario.yaml"
    link = validate(LinkSettings, scenario.delay_node, origin, LINK)
    line = _line_in_force(recording, session)
    line = line or _Line(link.forward.delay_s + link.backward.delay_s, facts["link_profile"])
    return Conditions(
        scenario=session.scenario,
        law=" then ".join(facts["law"]),
        parameters=facts["parameters"],
        environment=str(scenario.afm_node.get("environment", "tip_sample")),
        round_trip_ms=round(1e3 * line.delay_s, 6),
        link_profile=line.network,
        link_seed=facts["link_seed"],
        instrument=instrument_name(scenario.instrument, scenario.afm_node),
        sample=sample_in_words(scenario),
        hand=hand_in_words(scenario, origin),
        changed=tuple(facts["changed"]),
    )


class _Line(NamedTuple):
    """Settings of the link: the sum of the fixed delays there and back [s], and the name of the network."""

    delay_s: float
    network: str


def _line_in_force(recording: RecordingSource, session: Session) -> _Line | None:
    """Return the link's settings as it reported them at the start of the session; None without a report.

    The link reports ten times a second. If it was not changed during the session, the first report after the start
    counts, because the one before may miss a change just before the start; otherwise the last one before the start.
    """
    changed = any(name_of(text.partition(":")[0]) == LINK for text in session.conditions["changed"])
    found: _Line | None = None
    reports = recording.select(lambda channel: channel.topic == "link/status" and channel.via == "direct")
    for report, fields in readable(reports, recording.left_out):
        at_ns = session.timeline.time_ns(report)
        begun = at_ns >= session.start_ns
        if found is not None and begun and changed:
            break
        there, back = fields["forward"], fields["backward"]
        delays_s = (float(way["settings"].get("delay_s", 0.0)) for way in (there, back))
        found = _Line(sum(delays_s), str(there["profile"]))
        if begun:
            break
    return found

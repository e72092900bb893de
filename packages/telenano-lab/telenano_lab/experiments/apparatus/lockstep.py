"""Trials in simulated time: the steps of the nodes without processes, as `telenano.simulate` runs them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from telenano.recording import ColumnTable
from telenano_lab.experiments.apparatus.base import Apparatus, Course, Take
from telenano_lab.experiments.extend import TrialData
from telenano_lab.experiments.types import particle_table


def _simulate(document: Mapping[str, Any], origin: str, steers: Any = None) -> Any:
    # The models of the closed loop take seconds to load.
    from telenano import SimulatedSession

    return SimulatedSession.of(document, origin, steers)


class Lockstep(Apparatus):
    """An apparatus without processes or clock, whose desk shows and asks nothing; nothing can disturb a trial."""

    def take(self, course: Course) -> Take:
        document = {**course.document, "duration_s": course.duration_s}
        link = {"seed": course.trial.seed, **document.get("delay_node", {})}
        document = {**document, "delay_node": link}
        hand = self.steering(course)
        steered = () if hand is None else (hand,)
        session = _simulate(document, str(self.plan.path), *steered)
        conditions = session.conditions
        data = TrialData(session.table("afm/state"), session.table("haptic/state"), empty("law/status"))
        if hand is not None:
            places = (session[name] for name in ("time_s", "particle_x_m", "particle_y_m"))
            data = data._replace(particles=particle_table(*places))
        verified = {
            "law": conditions.law,
            "round_trip_ms": session.measured_round_trip_ms,
            "profile": conditions.link_profile,
            "link_seed": conditions.link_seed,
        }
        return Take(data, "", "", verified)


def empty(topic: str) -> ColumnTable:
    """Return an empty table of a topic, such as law/status, which lockstep does not have."""
    return ColumnTable(topic, {"time_s": np.empty(0)}, {"time_s": "s"}, {"time_s": "Time since the trial began"})

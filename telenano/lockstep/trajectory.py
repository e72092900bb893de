"""The trajectory of a run in lockstep, with the views that an analysis needs: instrument, context and judged holds.

course = rig.run(schedule, settle)
course.tip_force_n[course.follows]
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from telenano.afm.safety import MODE_FOLLOW, MODE_HOLD, REASON_NAMES
from telenano.analysis.holds import NO_CONTEXT, Guard, Hold, Instrument, Limits, SessionContext, judge_holds
from telenano.analysis.interruptions import ModeReport, interruptions_of
from telenano.analysis.stated_noise import stated_noise
from telenano.extend.instruments import SafetyParams
from telenano.sections.afm_section import AfmConfig
from telenano.sections.controller_section import KNOWN_LAWS, ControllerConfig

Series = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Results of a run from the start of the session, one value per tick of the hand, each of shape (n,).

    hand_force_n, hand_position_m: F_m [N] on the device and x_m [m] at the tick. All others are the values at the end
    of the tick: reference_m, x_mr [m]; rendered_force_n, the force that the law attributes to the environment, at the
    hand's scale [N]; base_position_m, x_s [m]; tip_force_n, F_s [N]; separation_m, h [m]; hand_energy_j, the work of
    the hand on its device [J], the integral of F_m dx_m; tip_energy_j, the work of the base on cantilever and sample
    [J], the integral of F_s dx_s; in_contact; instrument_mode (MODE_* of the AFM's safety chain); hand_following;
    instrument_reason, the reason for the last change of that mode (REASON_*); withdrawn_s, the time at which the
    instrument last ceased to follow [s], negative before the session and NaN if it never did; across, shape (n, 10) or
    wider, the rows of the lateral path (`telenano.lockstep.across`), or None; begins_s, the time for which the rig ran
    before the session [s].
    """

    time_s: Series
    hand_force_n: Series
    hand_position_m: Series
    reference_m: Series
    rendered_force_n: Series
    base_position_m: Series
    tip_force_n: Series
    separation_m: Series
    hand_energy_j: Series
    tip_energy_j: Series
    in_contact: npt.NDArray[np.bool_]
    instrument_mode: npt.NDArray[np.int64]
    hand_following: npt.NDArray[np.bool_]
    instrument_reason: npt.NDArray[np.int64]
    withdrawn_s: Series
    across: Series | None = None
    begins_s: float = 0.0

    @property
    def follows(self) -> npt.NDArray[np.bool_]:
        """Whether the instrument follows its reference, shape (n,)."""
        return np.equal(self.instrument_mode, MODE_FOLLOW)

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """Whether the instrument holds its base, as it does in a pause of the commands, shape (n,)."""
        return np.equal(self.instrument_mode, MODE_HOLD)

    def tip(self, position_scale: float | None = None, *, knows_contact: bool = True) -> Instrument:
        """Return the states of the instrument; with position_scale, alpha_p, also the lead of the hand over it [m]."""
        apart_m = None
        if position_scale is not None:
            apart_m = self.hand_position_m - self.base_position_m / position_scale
        return Instrument(self.follows | self.held, self.in_contact, self.held, apart_m, knows_contact)

    def context(self, safety: SafetyParams | None, context: SessionContext = NO_CONTEXT) -> SessionContext:
        """Return `context` with the limits, the action of the guard, and the times at which the loop was open."""
        withdrawn = np.flatnonzero(np.isfinite(self.withdrawn_s))[:1].tolist()
        reasons = [REASON_NAMES[int(self.instrument_reason[i])] for i in withdrawn]
        guards = [Guard(float(self.withdrawn_s[i]), why) for i, why in zip(withdrawn, reasons, strict=True)]
        if safety is not None:
            limits = Limits(safety.force_limit_n, safety.command_deadline_s + safety.hold_time_s)
            context = context._replace(limits=limits)
        begins = np.flatnonzero(np.diff(self.held, prepend=False) & self.held)
        why = self.instrument_reason
        reports = [ModeReport(float(self.time_s[i]), "hold", REASON_NAMES[int(why[i])]) for i in begins]
        interruptions = interruptions_of("tip_held", self.time_s, self.held, reports)
        # A hand is released if commands are missing, or if the law uncouples it from a tip that is held or away.
        interruptions += interruptions_of("hand_let_go", self.time_s, ~self.hand_following, ())
        return context._replace(guards=guards, interruptions=sorted(interruptions, key=lambda one: one.start_s))

    def holds(
        self,
        controller: ControllerConfig,
        transit_s: float,
        deadlines_s: Sequence[float],
        spans: Sequence[tuple[float, float, float]],
        *,
        knows_contact: bool = True,
        afm: AfmConfig | None = None,
    ) -> list[Hold]:
        """Return the holds of the hand, each with its judgement.

        Args:
            controller: The configuration of the law that ran.
            transit_s: The time for which a command is in transit in the loop [s].
            deadlines_s: The deadlines for commands of both devices [s].
            spans: Begin and end of each hold [s], with the force of the hand in it [N].
            knows_contact: Whether the instrument measures contact.
            afm: The configuration of the instrument, which states the noise of its read-out; None if it is unknown.
        """
        section = controller.law_config()
        tip = self.tip(section.position_scale, knows_contact=knows_contact)
        noise = None if afm is None else stated_noise(afm, section.force_scale)
        context = self.context(None, known_of(controller, transit_s, *deadlines_s)._replace(noise=noise))
        tip_n = section.force_scale * self.tip_force_n
        return judge_holds(self.time_s, self.hand_force_n, self.time_s, tip_n, tip, context, spans)


def known_of(controller: ControllerConfig, transit_s: float, *deadlines_s: float) -> SessionContext:
    """Return the context that follows from law and link: rest force of the law, transit time and deadline [s]."""
    rest_force = KNOWN_LAWS[controller.law].rest_force
    own = None if rest_force is None else functools.partial(rest_force, controller.params())
    return SessionContext(deadline_s=max(deadlines_s), transit_s=transit_s, rest_force=own)

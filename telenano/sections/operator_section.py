"""Settings of the simulated hand: its force or path over a session, and the constants of its arm."""

from functools import reduce
from operator import or_
from random import Random
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from telenano.hand.operator import FORCE_PROFILE, IMPEDANCE, OperatorParams
from telenano.hand.reacting import ReactingParams
from telenano.sections.lateral_hand_section import Corner, Course
from telenano.sections.operator_kinds import OPERATOR_MODELS, unusable_config
from telenano.settings.config import Settings, filled


class ForcePoint(Corner):
    """One corner of a force profile."""

    force_n: float = Field(ge=-1e3, le=1e3, description="Force of the hand on the device, towards the sample > 0 [N]")


class PathPoint(Corner):
    """One corner of an intended path."""

    position_m: float = Field(ge=-1.0, le=1.0, description="Intended position of the hand, towards the sample > 0 [m]")


# Fig. 12: nothing until 0.8 s, 1 N from 1.2 to 2.6 s, 2 N from 2.9 to 4.5 s, let go by 4.6 s.
FIG12_POINTS = tuple(
    ForcePoint(time_s=t, force_n=f) for t, f in ((0.8, 0.0), (1.2, 1.0), (2.6, 1.0), (2.9, 2.0), (4.5, 2.0), (4.6, 0.0))
)


# The number of moves with a scatter of their own; after these the draws repeat.
_DRAWS = 64


MaxForce = Annotated[
    float, Field(ge=1e-12, le=1e3, description="Greatest force that hand and force sensor take [N]; [1e-12, 1e3]")
]


class ForceProfileConfig(Settings):
    """A hand that presses with a given force, regardless of the motion of the device."""

    kind: Literal["force_profile"] = Field(description="Selects this model of the hand")
    points: Course[ForcePoint] = Field(
        default=FIG12_POINTS,
        min_length=1,
        max_length=10_000,
        description="Corners of F_m(t): linear between, zero before the first, the last force held after it",
    )
    max_force_n: MaxForce = 10.0

    def to_params(self) -> OperatorParams:
        times = np.array([point.time_s for point in self.points])
        forces = np.array([point.force_n for point in self.points])
        return OperatorParams(kind=FORCE_PROFILE, times_s=times, values=forces, max_force_n=self.max_force_n)


class ArmConstants(NamedTuple):
    """k [N/m], b [N s/m] and m [kg] of an arm about its intended path."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    mass_kg: float


ArmName = Literal["soft", "ordinary", "stiff"]
# Stiffness at the hand in a posture is 100 to 700 N/m (F. A. Mussa-Ivaldi, N. Hogan, E. Bizzi, J. Neuroscience 5, 1985;
# T. Tsuji et al., Biological Cybernetics 72, 1995), that of a finger that presses with 2 to 20 N is 200 to 1000 N/m
# (A. Z. Hajian, R. D. Howe, J. Biomechanical Engineering 119, 1997). The values are our own choice, which spans these.
ARMS: dict[ArmName, ArmConstants] = {
    "soft": ArmConstants(50.0, 5.0, 0.15),
    "ordinary": ArmConstants(300.0, 5.0, 0.15),
    "stiff": ArmConstants(1000.0, 20.0, 0.15),
}


class ImpedanceConfig(Settings):
    """A hand with mass, damper and spring moving along an intended path."""

    kind: Literal["impedance"] = Field(description="Selects this model of the hand")
    path: Course[PathPoint] = Field(
        min_length=1,
        max_length=10_000,
        description="Corners of the intended path: linear between, the end values held outside",
    )
    arm: ArmName = Field(default="ordinary", description="Named arm, whose constants apply where none are given here")
    stiffness_n_per_m: float | None = Field(
        default=None, ge=0.0, le=1e6, description="Spring k of the arm [N/m]; [0, 1e6]; none: that of the named arm"
    )
    damping_n_s_per_m: float | None = Field(
        default=None, ge=0.0, le=1e5, description="Damper b of the arm [N s/m]; [0, 1e5]; none: that of the named arm"
    )
    mass_kg: float | None = Field(
        default=None,
        ge=0.0,
        le=100.0,
        description="Moving mass m of the hand [kg]; [0, 100]; none: the named arm's",
    )
    pad_stiffness_n_per_m: float = Field(
        default=5000.0, ge=1e-6, le=1e7, description="Finger pad between mass and device, spring k_p [N/m]; [1e-6, 1e7]"
    )
    pad_damping_n_s_per_m: float = Field(
        default=10.0, ge=1e-6, le=1e6, description="Finger pad between mass and device, damper b_p [N s/m]; [1e-6, 1e6]"
    )
    max_force_n: MaxForce = 10.0

    @property
    def constants(self) -> ArmConstants:
        """The constants of the arm: those of the named arm, except for values that this section gives itself."""
        arm, k, b, m = ARMS[self.arm], self.stiffness_n_per_m, self.damping_n_s_per_m, self.mass_kg
        return ArmConstants(
            arm.stiffness_n_per_m if k is None else k,
            arm.damping_n_s_per_m if b is None else b,
            arm.mass_kg if m is None else m,
        )

    def to_params(self) -> OperatorParams:
        return filled(
            OperatorParams,
            self,
            kind=IMPEDANCE,
            times_s=np.array([point.time_s for point in self.path]),
            values=np.array([point.position_m for point in self.path]),
            **self.constants._asdict(),
        )


class InteractiveConfig(Settings):
    """A hand that presses with the force of operator/force while the session runs: a person at the page of the view."""

    kind: Literal["interactive"] = Field(description="Selects this model of the hand")
    force_deadline_s: float = Field(
        default=0.1,
        ge=0.01,
        le=1.0,
        description="Age of the newest operator/force at which the hand's force becomes 0 [s]; [0.01, 1]",
    )
    max_force_n: MaxForce = 10.0

    def to_params(self) -> OperatorParams:
        # A profile of one corner: the device holds this force until it receives another one.
        none = np.zeros(1)
        return OperatorParams(kind=FORCE_PROFILE, times_s=none, values=none, max_force_n=self.max_force_n)


class ReactingConfig(Settings):
    """A hand that moves and waits: it presses, waits for the arm to stand still and for the answer, and corrects."""

    kind: Literal["reacting"] = Field(description="Selects this model of the hand")
    points: Course[ForcePoint] = Field(
        default=(ForcePoint(time_s=0.0, force_n=1.0),),
        min_length=1,
        max_length=10_000,
        description="Corners of the force at which the hand aims: linear between, the end values held outside",
    )
    reaction_time_s: float = Field(
        default=0.25, ge=1e-3, le=10.0, description="Time for which the arm has to stand still before the next move [s]"
    )
    answer_s: float = Field(
        default=0.0,
        ge=0.0,
        le=60.0,
        description="Additional wait that the hand has learnt, the round trip [s]; [0, 60]",
    )
    still_m_per_s: float = Field(
        default=1e-3, ge=1e-6, le=1.0, description="Speed below which the arm stands still [m/s]; [1e-6, 1]"
    )
    gain: float = Field(default=0.6, gt=0.0, le=1.9, description="Share of the error that a move corrects; (0, 1.9]")
    noise: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Standard deviation of that share, relative to it; [0, 1]"
    )
    seed: int = Field(default=0, ge=0, lt=2**63, description="Seed of the scatter")
    tolerance_n: float = Field(default=0.05, ge=1e-6, le=1e3, description="Error that the hand leaves uncorrected [N]")
    rate_n_per_s: float = Field(
        default=10.0, gt=0.0, le=1e4, description="Rate at which the hand's force changes [N/s]"
    )
    max_force_n: MaxForce = 10.0

    def to_params(self) -> ReactingParams:
        draw = Random(self.seed)
        return filled(
            ReactingParams,
            self,
            times_s=np.array([point.time_s for point in self.points]),
            values=np.array([point.force_n for point in self.points]),
            errors=np.array([draw.gauss(0.0, 1.0) for _ in range(_DRAWS)]),
        )


if TYPE_CHECKING:
    OperatorConfig = Annotated[
        ForceProfileConfig | ImpedanceConfig | InteractiveConfig | ReactingConfig, Field(discriminator="kind")
    ]
else:
    # The kinds include those of installed packages.
    _KINDS = (ForceProfileConfig, ImpedanceConfig, InteractiveConfig, ReactingConfig)
    _KINDS += tuple(model.config for model in OPERATOR_MODELS.found.values())
    _KINDS += tuple(unusable_config(name, problem) for name, problem in OPERATOR_MODELS.problems.items())
    OperatorConfig = Annotated[reduce(or_, _KINDS), Field(discriminator="kind")]

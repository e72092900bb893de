"""The laws of this project with the models of their sections: `telenano.laws` has their steps."""

from typing import Literal

from pydantic import Field

from telenano.extend import pass_through
from telenano.extend.laws import MOST_PERIODS_A_STEP, Law
from telenano.extend.ranges import parameter
from telenano.extend.virtual_mass import MassConfig, ScaledConfig
from telenano.laws import passivity, position_force, tactile, virtual_impedance, wave
from telenano.laws.passivity import PassivityParams
from telenano.laws.position_force import PositionForceParams
from telenano.laws.tactile import TactileParams, impedance_scaled
from telenano.laws.virtual_impedance import VirtualImpedanceParams
from telenano.laws.wave import WaveParams
from telenano.numerics.discretisation import approach, decay, exact_discretisation
from telenano.settings.config import filled

# The clamp's time constant once the hand no longer presses [s]. It is not 0, because an arm that swings on a soft
# sample pulls for moments.
_LET_GO_S = 0.2
# A store that begins empty has this level [J].
_LEAST_LEVEL_J = 1e-9


class ImpedanceConfig(ScaledConfig):
    """A virtual impedance; the defaults are the paper's values in SI units (E8)."""

    mass_kg: float = parameter(10.0, "kg", "Virtual mass M_v [kg]")
    damping_n_s_per_m: float = parameter(2000.0, "N s/m", "Virtual damping B_v [N s/m]", zero=True)
    stiffness_n_per_m: float = parameter(0.0, "N/m", "Virtual stiffness K_v [N/m]", zero=True)
    force_gain: float = parameter(20.0, "1", "Gain of the force error K_f")

    def impedance_params(self, period_s: float) -> VirtualImpedanceParams:
        """Return the constants of the impedance for a period [s] of the hand."""
        step = exact_discretisation(self.mass_kg, self.damping_n_s_per_m, self.stiffness_n_per_m, period_s)
        return filled(VirtualImpedanceParams, self, period_s=period_s, impedance=step)


class VirtualImpedanceConfig(ImpedanceConfig):
    """Section `controller.virtual_impedance`."""

    def to_params(self, period_s: float) -> VirtualImpedanceParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        return self.impedance_params(period_s)


class PositionForceConfig(MassConfig):
    """Section `controller.position_force`."""

    def to_params(self, period_s: float) -> PositionForceParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        return PositionForceParams(self.mass_params(period_s))


class WaveConfig(MassConfig):
    """Section `controller.wave`."""

    impedance_n_s_per_m: float = parameter(100.0, "N s/m", "Impedance of the line b [N s/m]")
    silence_limit_s: float = parameter(
        0.5,
        "s",
        "Time without a signal from the other half after which the hand is let go [s]: waves die out with filter_s by "
        "themselves, and a line that comes back has lost the signals in transit",
    )
    filter_s: float = parameter(0.02, "s", "Time constant of the wave filter tau_f [s]; 0 = none", zero=True)
    fade_s: float = parameter(
        1.0, "s", "Time constant with which a force at the tip when the law comes into force fades tau_0 [s]"
    )

    def to_params(self, period_s: float) -> WaveParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        b = self.impedance_n_s_per_m
        share = 1.0 if self.filter_s == 0.0 else approach(period_s / self.filter_s)
        fade = decay(period_s / self.fade_s)
        return WaveParams(
            mass=self.mass_params(period_s, b),
            impedance_n_s_per_m=b,
            share=share,
            fade=fade,
            bridge_s=max(self.filter_s, period_s),
            clamped=False,
            margin_n=0.0,
        )

    def stiffness_limit_n_per_m(self, period_s: float) -> float:
        """Return the stiffest sample [N/m] that the slave half tolerates, given its long steps after late signals."""
        return self.limit_of_damper(self.impedance_n_s_per_m, period_s, MOST_PERIODS_A_STEP)


class PassivityConfig(MassConfig):
    """Section `controller.passivity`; energies, stiffness and damping at the hand's scale."""

    silence_limit_s: float = parameter(
        0.5,
        "s",
        "Time without a signal from the other half after which the hand is let go [s]: energy that has not arrived "
        "cannot be spent, and after each interruption hand and tip differ by their motion in between",
    )
    coupling_stiffness_n_per_m: float = parameter(1500.0, "N/m", "Spring of the coupling K_c [N/m]")
    coupling_damping_n_s_per_m: float = parameter(60.0, "N s/m", "Damper of the base B_c [N s/m]")
    speed_limit_m_per_s: float = parameter(
        0.05, "m/s", "Fastest motion of the slave's reference, at the hand's scale [m/s]"
    )
    force_margin_n: float = parameter(
        0.0, "N", "Force by which the slave may press harder than the hand, at the hand's scale F_0 [N]"
    )
    clamp_release_s: float = parameter(
        4.0, "s", "Time constant with which the clamp follows a hand that presses less tau_c [s]"
    )
    start_energy_j: float = parameter(1e-3, "J", "Energy that each side may spend at the start E_0 [J]", zero=True)
    energy_cap_j: float = parameter(5e-3, "J", "Most energy that a side keeps to spend [J]")
    refill_damping_n_s_per_m: float = parameter(
        460.0,
        "N s/m",
        "Damper that the hand feels while the master's store is empty, less as the store nears E_0 B_t [N s/m]",
    )
    exchange_s: float = parameter(
        0.15, "s", "Time constant with which each side sends its store to the other tau_e [s]"
    )

    def to_params(self, period_s: float) -> PassivityParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        rate = self.coupling_stiffness_n_per_m / self.coupling_damping_n_s_per_m
        return PassivityParams(
            mass=self.mass_params(period_s),
            coupling_n_per_m=self.coupling_stiffness_n_per_m,
            relaxed=approach(rate * period_s),
            step_m=self.speed_limit_m_per_s * period_s,
            margin_n=self.force_margin_n,
            release=approach(period_s / self.clamp_release_s),
            let_go=approach(period_s / min(self.clamp_release_s, _LET_GO_S)),
            start_j=min(self.start_energy_j, self.energy_cap_j),
            cap_j=self.energy_cap_j,
            level_j=max(min(self.start_energy_j, self.energy_cap_j), _LEAST_LEVEL_J),
            refill_n_s_per_m=self.refill_damping_n_s_per_m,
            shared=approach(period_s / self.exchange_s),
        )

    def stiffness_limit_n_per_m(self, period_s: float) -> float:
        """Return the stiffest sample K that the loop of coupling and base tolerates [N/m].

        In a period the base covers relaxed (1 + K_e / K_c) of the way to its rest position, with K_e = alpha_f alpha_p
        K. At 2 the sample receives all the energy that the coupling releases, and above 2 more.
        """
        relaxed = approach(self.coupling_stiffness_n_per_m / self.coupling_damping_n_s_per_m * period_s)
        return (2.0 / relaxed - 1.0) * self.coupling_stiffness_n_per_m / (self.force_scale * self.position_scale)


class TactileConfig(ScaledConfig):
    """Section `controller.tactile`."""

    position_scale: float = parameter(
        1e-6, "m/m", "alpha_p, metres at the tip per metre at the hand; 1e-6 is the 0.1 cm/nm of Fig. 10"
    )
    cantilever_stiffness_n_per_m: float = parameter(
        40.0, "N/m", "Stiffness k of the cantilever of the instrument [N/m]"
    )
    scaling: Literal["linear", "impedance"] = Field(
        default="linear", description="Scaling of the force for the hand: Eq. 12, or Eq. 13 with the three keys below"
    )
    impedance_scale: float = Field(
        default=1e4, ge=1.0, le=1e6, description="alpha of Eq. 13: length at the hand per length at the tip"
    )
    cantilever_mass_kg: float = parameter(1e-6, "kg", "Mass of the cantilever in Eq. 13, m_c [kg]")
    cantilever_damping_n_s_per_m: float = parameter(
        0.0, "N s/m", "Damping of the cantilever in Eq. 13, b_c [N s/m]", zero=True
    )

    def to_params(self, period_s: float) -> TactileParams:
        """Return the constants of the compiled steps for a period [s] of the hand."""
        inertia, damping, spring = impedance_scaled(
            self.impedance_scale,
            self.cantilever_mass_kg,
            self.cantilever_damping_n_s_per_m,
            self.cantilever_stiffness_n_per_m,
        )
        return filled(
            TactileParams,
            self,
            period_s=period_s,
            stiffness_n_per_m=self.cantilever_stiffness_n_per_m,
            by_impedance=self.scaling == "impedance",
            inertia_kg=inertia,
            damping_n_s_per_m=damping,
            spring_n_per_m=spring,
        )


VIRTUAL_IMPEDANCE = Law.of(virtual_impedance.__name__, VirtualImpedanceConfig, slave=pass_through)
POSITION_FORCE = Law.of(position_force.__name__, PositionForceConfig, slave=pass_through)
WAVE = Law.of(
    wave.__name__,
    WaveConfig,
    uses_waves=True,
    uses_energy=True,
    local_loop=True,
    passive=True,
    fixed_in_contact=("impedance_n_s_per_m",),
)
PASSIVITY = Law.of(passivity.__name__, PassivityConfig, uses_energy=True, local_loop=True, passive=True)
TACTILE = Law.of(
    tactile.__name__, TactileConfig, link_loop=False, rest_force=None, must_know=("cantilever_stiffness_n_per_m",)
)

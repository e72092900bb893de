"""The linear loop of a law against a spring, for control engineers: transfer functions, margins, roots, two-port.

A law is a two-port (F_m, -v_s) = H (v_m, F_s) at the hand's scale (`theory`). Its slave port is terminated by the
spring, F_s = k v_s / s with k = alpha_f alpha_p K, and its master port by a hand of constant force, or by an arm Z_a
behind the device D, F_m = -Z_a D v_m / s. Broken at F_s, the loop is

    L(s) = k/s (h22 - h12 h21 / (h11 + Z_a D / s)),

and the closed loop has its roots where 1 + L(s) = 0. For laws that send position and force unchanged, this is G e^(-sT)
/ (Z_v + g Z_a D) with the whole delay in one place; between wave variables the delay is in both directions.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field

from telenano.sections import LAWS, ControllerConfig, HapticConfig
from telenano.settings import Settings, merge, nested, validate
from telenano.wire import ConfigError, known_names
from telenano_lab.studies.loops.theory import (
    Arm,
    Complex,
    Device,
    LoopModel,
    Margin,
    arm_response,
    critical_link_delay_s,
    delay_margin,
    hybrid_of,
    loop_model,
    margin_of,
    sampled_loop,
    transfer_function,
)

# A hand of constant force, or one of the arms of `haptic_node.operator.arm`.
Hand = Literal["force", "soft", "ordinary", "stiff"]
LINEAR_LAWS = ("virtual_impedance", "position_force", "wave")
# The start of Newton's method: a grid of the region with this number of growth rates, and of frequencies.
_STARTS = (16, 96)
# The most steps of Newton's method.
_STEPS = 40
# The greatest growth rate of a root that is sought [1/s].
_MOST_PER_S = 40.0
# The greatest frequency of a root that is sought [Hz].
_HIGHEST_HZ = 16.0


@dataclass(frozen=True)
class LinearLoop:
    """The loop of a law against a spring at a delay; made by `linear_loop`.

    round_trip_s: of link and devices [s]. arm: None for a hand of constant force.
    """

    law: str
    parameters: BaseModel
    stiffness_n_per_m: float
    round_trip_s: float
    period_s: float
    arm: Arm | None = None

    def __repr__(self) -> str:
        hand = ", with an arm" if self.arm is not None else ""
        return f"<LinearLoop {self.law} on {self.stiffness_n_per_m:g} N/m, {1e3 * self.delay_s:g} ms in all{hand}>"

    @property
    def delay_s(self) -> float:
        """The delay in the loop [s]: the round trip, and half a period for the hold of the force."""
        return self.round_trip_s + 0.5 * self.period_s

    @property
    def margin(self) -> Margin:
        """The margin of the loop: the total delay that it tolerates (T_c), infinite if it tolerates any.

        The phase and the crossover are those without delay. The line of `wave` is passive at every constant delay, and
        so is the loop through it.
        """
        if self._direct is None:
            return Margin(math.inf, math.inf, math.nan)
        if self.arm is None:
            return delay_margin(transfer_function(self._direct))
        return margin_of(arm_response(self._direct, self._hand_gain, self.arm, _device()))

    @property
    def critical_delay_s(self) -> float:
        """T_c [s]: the loop is stable if `delay_s` is less."""
        return self.margin.delay_s

    @property
    def critical_link_delay_s(self) -> float:
        """T_d [s]: the round trip of link and devices that the sampled loop tolerates.

        A loop with an arm is not sampled; for it the hold counts as half a period.
        """
        if self._direct is not None and self.arm is None:
            return critical_link_delay_s(self._direct, self.period_s)
        return max(0.0, self.critical_delay_s - 0.5 * self.period_s)

    def response(self, omega_rad_per_s: npt.ArrayLike) -> Complex:
        """Return L(j omega) with its delay at angular frequencies [rad/s], shape (n,)."""
        return np.asarray(self.at(1j * np.asarray(omega_rad_per_s, dtype=np.float64)), dtype=np.complex128)

    def two_port(self, omega_rad_per_s: npt.ArrayLike) -> Complex:
        """Return H of the law over the round trip, shape (n, 2, 2), as (F_m, -v_s) = H (v_m, F_s) at the hand's scale.

        Raises:
            ValueError: K_f is 0, so that no two-port in hybrid form exists.
        """
        omega = np.asarray(omega_rad_per_s, dtype=np.float64)
        hybrid = hybrid_of(self.law, self.parameters, self.round_trip_s, omega)
        assert hybrid is not None
        return hybrid

    def at(self, s: Any) -> Any:
        """Return L at complex frequencies s [1/s]."""
        above, below = self._rational()
        if self._direct is not None:
            return np.asarray(np.polyval(above, s) / np.polyval(below, s) * np.exp(-s * self.delay_s))
        b, lag = self._values["impedance_n_s_per_m"], 1.0 / (1.0 + self._values["filter_s"] * s)
        twice = lag * lag * np.exp(-s * self.delay_s)
        line = (1.0 - twice) / (1.0 + twice)
        hand = np.polyval(above, s) / np.polyval(below, s)
        return np.asarray(self._spring / (b * s) * (b + hand * line) / (hand + b * line))

    def transfer_function(self, pade_order: int = 6) -> Any:
        """Return L(s) as a `control.TransferFunction`; the delay is a Padé approximation of this order, 0 omits it."""
        import control

        up: Any
        down: Any
        up, down = control.pade(self.delay_s, pade_order) if pade_order else ([1.0], [1.0])
        above, below = self._rational()
        if self._direct is not None:
            return control.tf(np.polymul(above, up), np.polymul(below, down))
        lag = np.array([self._values["filter_s"], 1.0])
        down = np.polymul(down, np.polymul(lag, lag))
        b, plus, minus = self._values["impedance_n_s_per_m"], np.polyadd(down, up), np.polysub(down, up)
        # k/(b s) (P (D - N) + b Q (D + N)) / (P (D + N) + b Q (D - N)) with ac = N/D and the hand's P/Q. D - N and Q
        # are 0 at s = 0, and so is the numerator, whose last coefficient goes with the s of the spring.
        whole = np.polyadd(np.polymul(above, minus), b * np.polymul(below, plus))
        inner = np.polyadd(np.polymul(above, plus), b * np.polymul(below, minus))
        return control.tf(self._spring / b * whole[:-1], inner)

    def sampled(self) -> Any:
        """Return the sampled loop, which really runs, as an exact `control.StateSpace` with the delay in its states.

        As a fraction in z, whose order is the number of periods in the delay, it would lose its poles to rounding.

        Raises:
            ConfigError: The law is `wave`, whose halves each sample a filter, or there is an arm, which is not sampled.
        """
        import control

        if self._direct is None or self.arm is not None:
            what = "the law wave has no sampled form" if self._direct is None else "an arm is not sampled"
            raise ConfigError(f"{what}: take transfer_function(), or response() for the exact delay")
        loop = control.ss(sampled_loop(transfer_function(self._direct), self.period_s))
        count = int(self.round_trip_s / self.period_s + 1e-9)
        if not count:
            return loop
        first, last = np.eye(count, 1), np.eye(1, count, count - 1)
        return control.ss(np.eye(count, k=-1), first, last, 0.0, self.period_s) * loop

    def roots(self, least_per_s: float = -100.0) -> Complex:
        """Return the roots of 1 + L(s) = 0 in a region, the least damped first; those below 0 Hz mirror these.

        Args:
            least_per_s: The least growth rate [1/s].

        Returns:
            The roots [1/s], of frequencies >= 0.
        """
        top = 2.0 * math.pi * _HIGHEST_HZ
        real, imaginary = np.meshgrid(
            np.linspace(least_per_s, _MOST_PER_S, _STARTS[0]), np.linspace(0.0, top, _STARTS[1])
        )
        s = (real + 1j * imaginary).ravel() + 1e-3
        with np.errstate(all="ignore"):
            # The zeros of 1 + 1/L, which has no poles for laws that send position and force unchanged.
            for _ in range(_STEPS):
                value, step = 1.0 + 1.0 / self.at(s), 1e-6 * (1.0 + np.abs(s))
                slope = (1.0 / self.at(s + step) - 1.0 / self.at(s - step)) / (2.0 * step)
                s -= value / slope
            there = np.abs(1.0 + self.at(s)) < 1e-8
        s = s[there & (s.real >= least_per_s) & (s.real <= _MOST_PER_S) & (s.imag >= -1e-9) & (s.imag <= top)]
        roots_of_loop: list[complex] = []
        for one in sorted(s.tolist(), key=lambda each: -each.real):
            if all(abs(one - other) > 1e-4 for other in roots_of_loop):
                roots_of_loop.append(complex(one.real, abs(one.imag)))
        return np.array(roots_of_loop, dtype=np.complex128)

    @property
    def _values(self) -> dict[str, Any]:
        return self.parameters.model_dump()

    @property
    def _spring(self) -> float:
        return float(self._values["force_scale"] * self._values["position_scale"] * self.stiffness_n_per_m)

    @property
    def _direct(self) -> LoopModel | None:
        return loop_model(self.law, self.parameters, self.stiffness_n_per_m)

    @property
    def _hand_gain(self) -> float:
        return float(self._values.get("force_gain", 1.0))

    def _rational(self) -> tuple[Any, Any]:
        """Return numerator and denominator of L without delay; for `wave`, those of the part on the master's side.

        The latter is the force of mass, damper, spring and arm over their velocity.
        """
        direct, values = self._direct, self._values
        if direct is not None:
            mass, gain = np.array([direct.mass_kg, direct.damping_n_s_per_m, direct.stiffness_n_per_m]), self._hand_gain
        else:
            spring = values.get("stiffness_n_per_m", 0.0)
            mass, gain = np.array([values["mass_kg"], values["damping_n_s_per_m"], spring]), 1.0
        servo: Any = np.ones(1)
        held: Any = np.zeros(1)
        if self.arm is not None:
            square, damping = _device()
            servo = np.array([1.0, damping, square])
            held = gain * square * np.array([self.arm.mass_kg, self.arm.damping_n_s_per_m, self.arm.stiffness_n_per_m])
        total = np.polyadd(np.polymul(mass, servo), held)
        if direct is not None:
            return direct.gain_n_per_m * servo, total
        return total, np.polymul(servo, [1.0, 0.0])


def _device() -> Device:
    return Device(*HapticConfig().device.to_params().closed_loop_coefficients())


@functools.lru_cache(maxsize=8)
def arm_of(hand: Hand) -> Arm | None:
    """Return the arm of a hand, None for a constant force: `arm_of("soft").stiffness_n_per_m`."""
    if hand == "force":
        return None
    operator = {"kind": "impedance", "arm": hand, "path": ({"time_s": 0.0, "position_m": 0.0},)}
    arm = HapticConfig.model_validate({"operator": operator}).arm
    assert arm is not None
    return Arm(*arm)


def linear_loop(controller: ControllerConfig, stiffness_n_per_m: float, round_trip_s: float, hand: Hand) -> LinearLoop:
    """Return the linear loop of the law in force against a spring.

    Args:
        controller: The configuration of both halves, without its force clamp.
        stiffness_n_per_m: K of the spring [N/m].
        round_trip_s: The round trip of link and devices [s].
        hand: `force`, a constant force, or the name of an arm.

    Raises:
        ConfigError: The law or the clamp has no linear loop.
    """
    if reason := not_linear(controller):
        raise ConfigError(reason)
    law = controller.law_config()
    return LinearLoop(controller.law, law, stiffness_n_per_m, round_trip_s, controller.period_s, arm_of(hand))


def not_linear(controller: ControllerConfig) -> str:
    """Return why the loop of a law against a spring is not linear; empty if it is."""
    if controller.law not in LINEAR_LAWS:
        return f"{controller.law} has no linear loop; {', '.join(LINEAR_LAWS)} have"
    if controller.clamp.enabled:
        return f"the force clamp behind {controller.law} is not linear; leave controller.clamp.enabled out"
    return ""


class _Given(Settings):
    """The arguments of `theory`, in the ranges of the studies."""

    stiffness_n_per_m: float = Field(gt=0.0, le=1e6)
    round_trip_ms: float = Field(ge=0.0, le=1e5)
    hand: Hand


def theory(
    *,
    law: str = "virtual_impedance",
    environment: str = "spring",
    stiffness_n_per_m: float = 10.0,
    round_trip_ms: float = 0.0,
    hand: str = "force",
    settings: Mapping[str, float | int | str | bool] | None = None,
) -> LinearLoop:
    """Return the linear loop of a law: transfer functions for python-control, margins, roots and two-port.

    Args:
        law: The law: `virtual_impedance`, `position_force` or `wave`.
        environment: `spring`, the only linear environment.
        stiffness_n_per_m: K of the spring [N/m].
        round_trip_ms: The round trip of the link [ms].
        hand: `force`, a constant force, or an arm: `soft`, `ordinary`, `stiff`.
        settings: Keys of the section `controller`, such as {"virtual_impedance.force_gain": 10}.

    Returns:
        The loop, whose margins are those of `telenano study stability`.

    Raises:
        ConfigError: The law, hand or key is unknown, or the loop is not linear; the message says which.
    """
    if law not in LAWS:
        raise ConfigError(f"unknown law {law!r}, {known_names(law, LAWS)}")
    if environment != "spring":
        raise ConfigError(f"the environment {environment} is not linear; spring is, at the stiffness of a contact")
    asked = {"stiffness_n_per_m": stiffness_n_per_m, "round_trip_ms": round_trip_ms, "hand": hand}
    question = validate(_Given, asked, "theory")
    section = merge(nested(dict(settings or {}), "theory"), {"law": law})
    controller = validate(ControllerConfig, section, "theory", "controller")
    return linear_loop(controller, question.stiffness_n_per_m, 1e-3 * question.round_trip_ms, question.hand)

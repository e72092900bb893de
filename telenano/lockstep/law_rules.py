"""The rules that every law must keep, with their checks: in the tests for own laws, by `law check` for others.

The rig relies on them for any law: no jump when the law takes over, a stable hold of a spring, finite numbers at the
corners of every range. Passivity and the tolerated delay are no rules: `telenano study` measures them.
"""

import copy
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from telenano.extend.laws import NO_SIGNAL, NO_TIP, HandSample, MasterReference, PortSignal, TipMeasurement
from telenano.laws.hand_limits import HandLimits, free, let_through, received_within
from telenano.lockstep.law_corners import failures
from telenano.numerics.compiler import compiled_form, is_step
from telenano.sections.controller_section import LAWS, ControllerConfig
from telenano.wire.errors import described

_HAND = HandSample(5e-3, 0.01, 0.7, True)
_TIP = TipMeasurement(
    base_position_m=1.1e-8,
    force_n=7e-9,
    separation_m=1e-10,
    separation_valid=True,
    in_contact=True,
    following=True,
    outstanding_m=0.0,
)
_PERIOD_S = 1e-3
# Positions closer than this are equal, up to rounding [m].
_SAME_PLACE_M = 1e-20
# The speed of the hand and a force of 10 N move it no further than this in a period [m].
_HAND_JUMP_M = 2.5e-5
# They change its speed by no more than this in a period [m/s].
_HAND_JUMP_M_PER_S = 0.05
# Distance that a force of 0.7 N at the hand's scale moves a base through a damper of 30 N s/m in a period [m].
_TIP_JUMP_M = 0.7 / 30.0 * _PERIOD_S * 1.5e-6 * 1.001
# Time for which a hand holds a spring [s].
_HOLD_S = 4.0
# Stiffness of that spring [N/m].
_SPRING_N_PER_M = 20.0
# Greatest relative error of the holding force, and greatest swing of it for a hand of 1 N.
_HOLD_SHARE = 0.06
# Seed with which corners of the settings are drawn.
_CORNER_SEED = 1
# Number of corners that are drawn.
_CORNER_CASES = 8
# Distance of the wall from the tip that the hand approaches [m].
_WALL_M = 3e-9
# Stiffness of the wall, as a share of the limit that the law states.
_NEAR_LIMIT = 0.9
# Length of a session on the bench [periods].
_SESSION_TICKS = 3000
# Number of the last periods over which mean and swing of the force are taken.
_HOLD_TICKS = 500
# Factors by which a setting is multiplied in a held contact.
_RETUNED_BY = (0.5, 3.0)
# Number of periods for which the contact is observed after that.
_RETUNED_TICKS = 300
# Greatest change of the force shown to a hand of 1 N, and of the tip's force at its scale [N].
_FORCE_STEP = 0.05
# Greatest motion of the hand [m].
_HAND_STEP_M = 1e-4
# Way of the hand from its start to either end of its travel [m], and its greatest speed there [m/s].
_TRAVEL_M = 2e-3
_TRAVEL_M_PER_S = 0.03
# Force with which a hand presses at the end of its travel, and with which it draws back [N].
_PRESSED_N = 2.0
# Time for which it does so [periods].
_PRESSED_TICKS = 600
# Greatest excess of a reference over the travel [m], up to the search for a force.
_BEYOND_M = 1e-8
# Way that the hand of a law makes back within _LET_GO_TICKS periods, as a share of that at its start.
_LET_GO_SHARE = 0.5
_LET_GO_TICKS = 100
# Latency of an instrument behind a serial line or a network, with which a law is tried too [periods].
LATE_PERIODS = 4


class Rule(NamedTuple):
    """A rule in words, and its check, which yields a sentence for each violation by the law of a name."""

    name: str
    broken_by: Callable[[str], Iterator[str]]


def broken_rules(name: str) -> dict[str, list[str]]:
    """Return the violations of each rule by a law, by the name of the rule; an empty list if the law keeps it.

    Raises:
        ConfigError: There is no law of this name.
    """
    broken: dict[str, list[str]] = {}
    name = LAWS[name].name
    for rule in RULES:
        try:
            broken[rule.name] = list(rule.broken_by(name))
        # Any error that the law of a package raises is a violation of the rule.
        except Exception as error:  # noqa: BLE001
            broken[rule.name] = [f"fails: {described(error)}"]
    return broken


def _params(name: str, period_s: float = _PERIOD_S, **settings: float) -> Any:
    return ControllerConfig.model_validate({"law": name, "period_s": period_s, name: settings}).params()


def _settings(name: str) -> Iterator[str]:
    law = LAWS[name]
    if law.name != name:
        yield f"is registered under another name than its own, {law.name}"
    properties = law.config.model_json_schema()["properties"]
    for key, schema in properties.items():
        if "default" not in schema:
            yield f"{key} has no default"
        if schema.get("type") in ("number", "integer") and not {"minimum", "maximum"} <= set(schema):
            yield f"{key} has no range: give ge and le"
        if not schema.get("description"):
            yield f"{key} has no description"
    if law.config.model_config.get("extra") != "forbid":
        yield "an unknown key is accepted: model_config needs extra='forbid'"
    if not hasattr(type(_params(name)), "_fields"):
        yield f"to_params gives a {type(_params(name)).__name__}, must be a NamedTuple of the law's own"


def _takes_over(name: str) -> Iterator[str]:
    law, params = LAWS[name], _params(name)
    state = law.master_resume(params, _HAND, _TIP.base_position_m)
    state, forward = law.master_send(params, state, _HAND, _PERIOD_S)
    if not abs(forward.position_m - _TIP.base_position_m) < _SAME_PLACE_M:
        yield f"master_resume: the first reference is {forward.position_m:g} m, not that of the tip"
    slave = law.slave_start(params, _TIP)
    slave, wanted = law.slave_receive(params, slave, forward._replace(active=False), _TIP, _PERIOD_S)
    if not abs(wanted.position_m - _TIP.base_position_m) < _SAME_PLACE_M:
        yield f"slave_receive: the base goes to {wanted.position_m:g} m before the law is coupled"
    answer = law.slave_send(params, slave, _TIP, _PERIOD_S)[1]
    if not abs(answer.position_m - _TIP.base_position_m) < _SAME_PLACE_M:
        yield f"slave_send: the position is {answer.position_m:g} m, not that of the base"
    _, reference = law.master_receive(params, state, _HAND, answer._replace(silence_s=0.0), _PERIOD_S)
    if not reference.active:
        yield "master_receive: the hand is off though the tip follows"
    if not abs(reference.position_m - _HAND.position_m) < _HAND_JUMP_M:
        yield f"master_receive: the hand's reference jumps by {reference.position_m - _HAND.position_m:g} m"
    if not abs(reference.velocity_m_per_s - _HAND.velocity_m_per_s) < _HAND_JUMP_M_PER_S:
        yield f"master_receive: the hand's speed jumps to {reference.velocity_m_per_s:g} m/s"


def _begins(name: str) -> Iterator[str]:
    law, params = LAWS[name], _params(name)
    signal = NO_SIGNAL._replace(
        position_m=_TIP.base_position_m, force_n=_TIP.force_n, energy_j=0.3, active=True, silence_s=0.0
    )
    _, wanted = law.slave_receive(params, law.slave_start(params, _TIP), signal, _TIP, _PERIOD_S)
    if not abs(wanted.position_m - _TIP.base_position_m) < _TIP_JUMP_M:
        yield f"the base jumps by {wanted.position_m - _TIP.base_position_m:g} m in the first coupled period"


def _silence(name: str) -> Iterator[str]:
    law, params = LAWS[name], _params(name)
    state = law.master_start(params, _HAND)
    _, reference = law.master_receive(params, state, _HAND, NO_SIGNAL, _PERIOD_S)
    if reference.active:
        yield "master_receive: the hand is held though the other half was never heard"


def _holds_spring(name: str) -> Iterator[str]:
    for period_s in (5e-4, 1e-3, 2e-3):
        shown_n = 1e8 * _Bench(name, period_s=period_s).run(round(_HOLD_S / period_s), 1.0)[-1][1]
        if not abs(shown_n - 1.0) <= _HOLD_SHARE:
            yield (
                f"a hand of 1 N holds a spring of {_SPRING_N_PER_M:g} N/m with {shown_n:.3g} N after {_HOLD_S:g} s"
                f" without delay, at a period of {1e3 * period_s:g} ms; 1 within {100.0 * _HOLD_SHARE:g} % is required"
            )


def _touches(name: str) -> Iterator[str]:
    yield from _touched_badly(name, _SPRING_N_PER_M, (0,))
    for late, even in ((0, True), (LATE_PERIODS, True), (0, False)):
        limit = ControllerConfig(law=name).stiffness_limit_n_per_m(late, even=even)
        if limit is not None:
            yield from _touched_badly(name, _NEAR_LIMIT * limit, (late,) if even else (late, late + 1))


def _touched_badly(name: str, stiffness: float, lates: Sequence[int]) -> Iterator[str]:
    bench = _Bench(name, stiffness_n_per_m=stiffness, wall_m=_WALL_M, lates=lates)
    bench.run(20, 0.0, retracted=True)
    rows = bench.run(_SESSION_TICKS, 1.0)
    held = [1e8 * force_n for _, force_n in rows[-_HOLD_TICKS:]]
    mean, swing = sum(held) / len(held), max(held) - min(held)
    if not abs(mean - 1.0) <= _HOLD_SHARE or not swing <= _HOLD_SHARE:
        late = f" and reports it to the law {' and '.join(map(str, lates))} ms later," if any(lates) else ""
        yield (
            f"a hand of 1 N that goes to a wall of {stiffness:.4g} N/m, {1e9 * _WALL_M:g} nm away,{late} presses with"
            f" {mean:.3g} N on average and swings by {swing:.3g} N in the end; 1 N within"
            f" {100.0 * _HOLD_SHARE:g} % and no swing of more than that are required"
        )


class _Bench:
    """Both halves of a law over a link without delay, and a spring under the tip, or a wall that only pushes.

    lates: delays [ticks] of the measurements for the slave half, which are used in turn. limits: those of the hand.
    """

    def __init__(
        self,
        name: str,
        stiffness_n_per_m: float = _SPRING_N_PER_M,
        wall_m: float | None = None,
        lates: Sequence[int] = (0,),
        period_s: float = _PERIOD_S,
        limits: HandLimits | None = None,
    ) -> None:
        self.limits, self.stop = limits, free()
        self.reference, self.tip_reference_m = MasterReference(0.0, 0.0, 0.0, True), 0.0
        self.law, self.params, self.period_s = LAWS[name], _params(name, period_s), period_s
        self.stiffness_n_per_m, self.wall_m = stiffness_n_per_m, wall_m
        self.x, self.tip = 0.0, NO_TIP
        self.measured, self.lates = [NO_TIP] * (max(lates) + 1), itertools.cycle(lates)
        self.master = self.law.master_start(self.params, HandSample(0.0, 0.0, 0.0, True))
        self.slave = self.law.slave_start(self.params, self.tip)
        self.shown_n: list[float] = []
        self.reference_m: list[float] = []

    def retuned(self, **settings: float) -> "_Bench":
        """Return a bench that continues from here with other settings of the law at both halves."""
        other, params = copy.copy(self), _params(self.law.name, self.period_s, **settings)
        other.master = self.law.retune(self.params, params, self.master)
        other.slave = self.law.slave_retune(self.params, params, self.slave)
        other.params, other.shown_n = params, []
        return other

    def run(
        self, ticks: int, force_n: float, *, off: bool = False, retracted: bool = False
    ) -> list[tuple[float, float]]:
        """Return position of the hand [m] and force on the tip [N] at each tick; off: hand off; retracted: tip away."""
        rows = []
        for _ in range(ticks):
            hand = HandSample(self.x, 0.0, force_n, not off)
            sent = let_through(self.stop, hand)
            self.master, signal = self.law.master_send(self.params, self.master, sent, self.period_s)
            signal, self.tip_reference_m = signal._replace(silence_s=0.0), signal.position_m
            self.slave, wanted = self.law.slave_receive(self.params, self.slave, signal, self.tip, self.period_s)
            base = 0.0 if retracted else wanted.position_m
            pushed_n = self.stiffness_n_per_m * (base - (self.wall_m or 0.0))
            pushed_n = pushed_n if self.wall_m is None else max(pushed_n, 0.0)
            newest = NO_TIP._replace(
                base_position_m=base, force_n=pushed_n, in_contact=pushed_n != 0.0, following=not retracted
            )
            self.measured = [*self.measured[1:], newest]
            measured = self.measured[-1 - next(self.lates)]
            self.tip = measured._replace(outstanding_m=base - measured.base_position_m)
            self.slave, answer = self.law.slave_send(self.params, self.slave, self.tip, self.period_s)
            reference = self._receive(hand, answer._replace(silence_s=0.0))
            self.x = self.x if off else self._reached(reference.position_m)
            rows.append((self.x, newest.force_n))
            self.shown_n.append(reference.force_n)
            self.reference_m.append(reference.position_m)
        return rows

    def _reached(self, position_m: float) -> float:
        """Return the place of a device whose guard keeps it within its travel [m]."""
        return position_m if self.limits is None else min(max(position_m, self.limits.low_m), self.limits.high_m)

    def _receive(self, hand: HandSample, answer: PortSignal) -> MasterReference:
        law, params, state, dt = self.law, self.params, self.master, self.period_s
        if self.limits is None:
            self.master, self.reference = law.master_receive(params, state, hand, answer, dt)
        else:
            before, place = self.reference, self.tip_reference_m
            self.master, self.reference, self.stop = received_within(
                self.limits, law.master_receive, params, state, hand, answer, dt, before, place
            )
        return self.reference


def _ends(name: str) -> Iterator[str]:
    config = ControllerConfig.model_validate({"law": name, "period_s": _PERIOD_S})
    limits = config.hand_params()._replace(low_m=-_TRAVEL_M, high_m=_TRAVEL_M, speed_m_per_s=_TRAVEL_M_PER_S)
    first = _Bench(name, stiffness_n_per_m=0.0, limits=limits).run(_LET_GO_TICKS, _PRESSED_N)[-1][0]
    for side in (1, -1):
        bench = _Bench(name, stiffness_n_per_m=0.0, limits=limits)
        end_m = bench.run(_PRESSED_TICKS, side * _PRESSED_N)[-1][0]
        farthest_m = max(side * at_m for at_m in bench.reference_m)
        if not farthest_m <= _TRAVEL_M + _BEYOND_M:
            yield f"pressed at the end of a travel of {_TRAVEL_M:g} m, the hand's reference goes to {farthest_m:g} m"
        back = side * end_m - side * bench.run(_LET_GO_TICKS, -side * _PRESSED_N)[-1][0]
        if not back >= _LET_GO_SHARE * first:
            yield (
                f"drawn back from the end of its travel, the hand has made {1e3 * back:.3g} mm after {_LET_GO_TICKS}"
                f" periods, and {1e3 * first:.3g} mm at its start: the law has wound up"
            )


def _retunes(name: str) -> Iterator[str]:
    bench = _Bench(name)
    (hand_m, tip_n), shown_n = bench.run(_SESSION_TICKS, 1.0)[-1], bench.shown_n[-1]
    settings = bench.law.config.model_validate({})
    for key, schema in bench.law.config.model_json_schema()["properties"].items():
        value = getattr(settings, key)
        if key in bench.law.all_fixed_in_contact() or schema.get("type") not in ("number", "integer") or not value:
            continue
        for factor in _RETUNED_BY:
            other = bench.retuned(**{key: min(max(factor * value, schema["minimum"]), schema["maximum"])})
            rows = other.run(_RETUNED_TICKS, 1.0)
            way = max(abs(at_m - hand_m) for at_m, _ in rows)
            step = 1e8 * max(abs(force_n - tip_n) for _, force_n in rows)
            shown = max(abs(force_n - shown_n) for force_n in other.shown_n)
            if not (way <= _HAND_STEP_M and step <= _FORCE_STEP and shown <= _FORCE_STEP):
                yield (
                    f"{key} times {factor:g} while a hand of 1 N holds a spring: the force shown changes by"
                    f" {shown:.3g} N, that of the tip by {step:.3g} N, and the hand goes {1e3 * way:.3g} mm; at most"
                    f" {_FORCE_STEP:g} N and {1e3 * _HAND_STEP_M:g} mm are allowed; or name it in fixed_in_contact"
                )


def _arms_again(name: str) -> Iterator[str]:
    bench = _Bench(name)
    bench.run(20, 0.0, retracted=True)
    first = bench.run(400, 1.0)
    # The device is off while the hand moves, so that hand and tip part; then the tip retracts and the hand returns.
    bench.run(520, 1.0, off=True)
    bench.x += 1e-3
    bench.run(50, 1.0)
    bench.run(20, 0.0, off=True, retracted=True)
    bench.x = 0.0
    bench.run(150, 0.0, off=True, retracted=True)
    again = bench.run(400, 1.0)
    for tick, (before, after) in enumerate(zip(first, again, strict=True)):
        if not all(math.isclose(a, b, rel_tol=1e-6) for a, b in zip(before, after, strict=True)):
            yield f"{tick} ms after a new arming the hand is at {after[0]:g} m, and was at {before[0]:g} m in the first"
            return


def _pure(name: str) -> Iterator[str]:
    law, params = LAWS[name], _params(name)
    master, slave = law.master_start(params, _HAND), law.slave_start(params, _TIP)
    signal = NO_SIGNAL._replace(position_m=1e-8, force_n=3e-9, active=True, silence_s=0.0)
    calls: dict[str, tuple[Any, ...]] = {
        "master_send": (params, master, _HAND, _PERIOD_S),
        "master_receive": (params, master, _HAND, signal, _PERIOD_S),
        "slave_receive": (params, slave, signal, _TIP, _PERIOD_S),
        "slave_send": (params, slave, _TIP, _PERIOD_S),
    }
    for step, arguments in calls.items():
        function = getattr(law, step)
        first, second = function(*arguments), function(*arguments)
        if repr(first) != repr(second):
            yield f"{step} gives two answers to the same call: it must keep nothing and draw no random numbers"
        if not is_step(function):
            yield f"{step} is not marked @compiled"
        elif repr(compiled_form(function)(*arguments)) != repr(first):
            yield f"{step} gives other bits compiled than as plain Python"


def _finite(name: str) -> Iterator[str]:
    return failures(_CORNER_SEED, _CORNER_CASES, (name,))


RULES = (
    Rule("settings have defaults, ranges and descriptions", _settings),
    Rule("pure steps: the same call gives the same bits", _pure),
    Rule("takes over without moving hand or tip", _takes_over),
    Rule("begins without a jump of the tip", _begins),
    Rule("lets the hand go while the other half is silent", _silence),
    Rule("holds a spring without delay", _holds_spring),
    Rule(
        "touches a wall and holds it, up to nine tenths of the stiffness that it tolerates with a prompt "
        "instrument, with"
        f" one that answers {LATE_PERIODS} ms late, and over a line that loses every second signal",
        _touches,
    ),
    Rule("changes a setting in a held contact without a step of force or hand", _retunes),
    Rule("a session after a new arming is as the first", _arms_again),
    Rule("the ends of the hand's travel wind nothing up", _ends),
    Rule("gives numbers at the corners of every range", _finite),
)

"""Checks of both halves of every law at the corners of their inputs and settings, alone and with each other."""

import math
import random
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from telenano.extend.laws import (
    LONGEST_BRIDGED_PERIODS,
    NO_SIGNAL,
    NO_TIP,
    HandSample,
    Law,
    PortSignal,
    TipMeasurement,
    port_signal,
)
from telenano.laws.clamp import clamped
from telenano.laws.deadband import deadband, initial_deadband_state
from telenano.sections.controller_section import LAWS, OWN_LAWS, ControllerConfig
from telenano.wire.errors import described
from telenano.wire.ranges import ENERGY, FORCE, POSITION, VELOCITY, WAVE, WAY, Range

TICKS = 40
PERIODS_S = (1e-4, 1e-3, 0.1)
ORDINARY = {"position": 5e-9, "velocity": 1e-9, "force": 7e-9, "wave variable": 0.1, "energy": 1e-3}


class NotANumberError(Exception):
    """A law returned NaN or infinity."""


def check(where: str, value: Any) -> None:
    """Raise NotANumberError, which names it, if a part of a state or signal is infinite or NaN."""
    if isinstance(value, float) and not math.isfinite(value):
        raise NotANumberError(f"{where} is {value}")
    if isinstance(value, np.ndarray) and not np.isfinite(value).all():
        raise NotANumberError(f"{where} has an element that is not a number")
    if isinstance(value, tuple):
        names = getattr(value, "_fields", range(len(value)))
        for name, part in zip(names, value, strict=True):
            check(f"{where}.{name}", part)


def _corner_settings(name: str, rng: random.Random, way: str) -> dict[str, Any]:
    """Return settings of a law: all at their least or greatest values, or each at one of these, default or between."""
    settings: dict[str, Any] = {}
    for key, schema in LAWS[name].config.model_json_schema()["properties"].items():
        if schema["type"] == "boolean":
            settings[key] = rng.random() < 0.5
            continue
        low, high = schema["minimum"], schema["maximum"]
        between = math.exp(rng.uniform(math.log(max(low, 1e-15)), math.log(high)))
        pick = way if way != "mixed" else rng.choice(("low", "high", "default", "between"))
        settings[key] = {"low": low, "high": high, "default": schema["default"], "between": between}[pick]
    return settings


def _config_at_corners(name: str, period_s: float, rng: random.Random, way: str) -> ControllerConfig:
    """Return a configuration with the settings of law and clamp at corners of their ranges."""
    clamp = {"enabled": rng.choice((None, True, False)), "force_margin_n": rng.choice((0.0, 0.1, 1e6))}
    clamp |= {"damping_n_s_per_m": rng.choice((1e-6, 30.0, 1e9))}
    document = {"law": name, "period_s": period_s, "clamp": clamp, name: _corner_settings(name, rng, way)}
    return ControllerConfig.model_validate(document)


def _quantity(kind: Range, rng: random.Random) -> float:
    usual = ORDINARY.get(kind.quantity, 1e-3)
    return rng.choice((kind.low, kind.high, 0.0, usual, -usual, 5e-324, rng.uniform(kind.low, kind.high)))


def _hand_sample(rng: random.Random) -> HandSample:
    return HandSample(_quantity(POSITION, rng), _quantity(VELOCITY, rng), _quantity(FORCE, rng), rng.random() < 0.8)


def _tip_sample(rng: random.Random) -> TipMeasurement:
    position, force, apart = _quantity(POSITION, rng), _quantity(FORCE, rng), _quantity(POSITION, rng)
    return TipMeasurement(
        base_position_m=position,
        force_n=force,
        separation_m=apart,
        separation_valid=rng.random() < 0.5,
        in_contact=rng.random() < 0.7,
        following=rng.random() < 0.8,
        outstanding_m=rng.choice((0.0, _quantity(POSITION, rng))),
    )


def _signal_at_corners(rng: random.Random) -> PortSignal:
    return port_signal(
        position_m=_quantity(WAY, rng),
        velocity_m_per_s=_quantity(VELOCITY, rng),
        force_n=_quantity(FORCE, rng),
        wave_sqrt_w=_quantity(WAVE, rng),
        energy_j=_quantity(ENERGY, rng),
        separation_m=_quantity(POSITION, rng),
        separation_valid=rng.random() < 0.5,
        in_contact=rng.random() < 0.7,
        active=rng.random() < 0.8,
        silence_s=rng.choice((0.0, 1e-4, 0.04, 1e9, 9.3e9)),
        round_trip_s=rng.choice((0.0, 1e-3, 10.0, 9.3e9)),
    )


def _over_the_wire(signal: PortSignal) -> PortSignal:
    """Return a signal as the other half receives it: limited to the ranges of the wire."""
    ranges = dict(position_m=WAY, velocity_m_per_s=VELOCITY, force_n=FORCE, wave_sqrt_w=WAVE, energy_j=ENERGY)
    return signal._replace(**{key: min(max(getattr(signal, key), r.low), r.high) for key, r in ranges.items()})


class _Halves:
    """Both halves of a law with the same parameters."""

    def __init__(self, law: Law, config: ControllerConfig, rng: random.Random) -> None:
        self.law, self.period_s, self.rng = law, config.period_s, rng
        self.params, self.clamp = config.params(), config.clamp_params()
        params = self.params
        self.hand, self.tip = _hand_sample(rng), _tip_sample(rng)
        self.master = law.master_start(params, self.hand)
        if rng.random() < 0.5:
            self.master = law.master_resume(params, self.hand, _quantity(WAY, rng))
        self.slave = law.slave_start(params, self.tip)
        self.band = initial_deadband_state(NO_SIGNAL)

    def dt_s(self) -> float:
        return self.period_s * self.rng.choice((1, 1, 1, 2, LONGEST_BRIDGED_PERIODS))

    def forward(self) -> PortSignal:
        dt = self.dt_s()
        signal: PortSignal
        self.master, signal = self.law.master_send(self.params, self.master, self.hand, dt)
        check("master_send", (self.master, signal))
        limits = ControllerConfig().deadband.model_copy(update={"enabled": True}).to_params()
        self.band, _ = deadband(limits, self.band, _over_the_wire(signal), dt)
        return signal

    def backward(self, signal: PortSignal) -> tuple[float, PortSignal]:
        # The slave half steps by one period per call.
        period_s = self.period_s
        self.slave, wanted = self.law.slave_receive(self.params, self.slave, signal, self.tip, period_s)
        check("slave_receive", (self.slave, wanted))
        wanted = clamped(self.clamp, wanted, signal, self.tip)
        check("clamped", wanted)
        self.slave, answer = self.law.slave_send(self.params, self.slave, self.tip, period_s)
        check("slave_send", (self.slave, answer))
        check("slave_energy_account", self.law.slave_energy_account(self.params, self.slave))
        return wanted.position_m, answer

    def receive(self, signal: PortSignal) -> float:
        self.master, reference = self.law.master_receive(self.params, self.master, self.hand, signal, self.dt_s())
        check("master_receive", (self.master, reference))
        check("master_energy_account", self.law.master_energy_account(self.params, self.master))
        return float(reference.position_m)

    def retune(self, config: ControllerConfig) -> None:
        params = config.params()
        self.master = self.law.retune(self.params, params, self.master)
        self.slave = self.law.slave_retune(self.params, params, self.slave)
        self.params, self.clamp = params, config.clamp_params()
        check("retune", (self.master, self.slave))


def _run_apart(halves: _Halves) -> None:
    """Give each half random inputs within the ranges at every tick."""
    for _ in range(TICKS):
        halves.hand, halves.tip = _hand_sample(halves.rng), _tip_sample(halves.rng)
        halves.forward()
        halves.backward(_signal_at_corners(halves.rng))
        halves.receive(_signal_at_corners(halves.rng))


def _run_together(halves: _Halves) -> None:
    """Let the halves answer each other on a stiff spring: instability grows until the ranges limit it."""
    stiffness, hand_n = halves.rng.choice((1.0, 20.0, 1e9)), halves.rng.choice((1.0, 1e6))
    halves.hand = HandSample(0.0, 0.0, hand_n, True)
    halves.tip = NO_TIP._replace(separation_valid=True, in_contact=True, following=True)
    for _ in range(TICKS):
        forward = _over_the_wire(halves.forward())._replace(active=True, silence_s=0.0)
        base, answer = halves.backward(forward)
        base = min(max(base, POSITION.low), POSITION.high)
        force = min(max(stiffness * base, FORCE.low), FORCE.high)
        halves.tip = halves.tip._replace(base_position_m=base, force_n=force, separation_m=-base)
        late_s = halves.rng.choice((0.0, 1.0, 4.0)) * halves.period_s
        answer = _over_the_wire(answer)._replace(active=True, silence_s=0.0, round_trip_s=late_s)
        reference = halves.receive(answer)
        reference = min(max(reference, POSITION.low), POSITION.high)
        speed = (reference - halves.hand.position_m) / halves.period_s
        halves.hand = HandSample(reference, min(max(speed, VELOCITY.low), VELOCITY.high), hand_n, True)


def failures(seed: int, cases: int, laws: Iterable[str] = OWN_LAWS) -> Iterator[str]:
    """Yield a line for each case in which a law raised an error, or returned NaN or infinity."""
    for name in laws:
        law = LAWS[name]
        for case in range(cases):
            rng = random.Random(f"{seed} {name} {case}")
            way = {0: "low", 1: "high"}.get(case, "mixed")
            period_s = rng.choice(PERIODS_S)
            first, second = (_config_at_corners(name, period_s, rng, which) for which in (way, "mixed"))
            try:
                for run in (_run_apart, _run_together):
                    halves = _Halves(law, first, rng)
                    run(halves)
                    halves.retune(second)
                    run(halves)
            except (NotANumberError, ArithmeticError, ValueError) as error:
                yield f"{name}, case {case} of seed {seed}: {described(error)}"

"""The 1-DOF haptic device: a DC motor on a fine screw under a proportional position servo (Eq. 1-2, Table 1).

From armature voltage u to arm position x the motor is C(s) = Km Kp / (s (Tm s + 1)) (Eq. 1), that is
Tm x'' + x' = Km Kp (u - V_f sign x'). The servo u = G (r - x) closes it to M(s) = a^2 / (s^2 + b s + a^2) with
b = 1/Tm and a^2 = G Km Kp / Tm (Eq. 2). With the printed G = 10 000 V/m the -3 dB bandwidth is 1.318 Hz, not the
30 Hz of Table 1 (erratum E1); both gains are presets of `config.py`.

Coulomb friction is a torque at the motor. K_t = K_e = 1/Km, so it acts like the voltage V_f = tau_f R Km. The
armature resistance R is not in the paper: the preset value is ours. It sets V_f, the torque for a given voltage
and nothing else in the linear response.

The operator's force does not appear here: "there is no power transmission from operator to the master arm". A push
of 10 N at the arm is 0.28 mN m at the motor, a tenth of its friction. The motor's torque through the screw is up to
1.8 kN; friction and the inertia of the rotor take all of it, and the arm gives the hand exactly what the hand presses.
"""

import math
from typing import NamedTuple

from telenano.extend.hands import MODE_POSITION
from telenano.numerics.compiler import compiled

# Inside one regime (servo, voltage limit, torque limit) a sub-step of any length is exact. A sub-step with a limit at
# one of its ends is repeated in finer ones, because the moment of the change of regime is then unknown. These are at
# most a quarter of Tm, so that a torque held too long by one of them cannot drive the motor past its no-load speed.
SUBSTEP_S = 1e-3
LIMITED_SUBSTEPS = 4
# An overdamped servo creeps for ever towards the edge of its friction band: below a picometre a second it has arrived.
# It then sticks, and stays stuck, because breaking away takes a millionth more than friction in motion.
CREEP_M_PER_S = 1e-12
BREAKAWAY = 1.0 + 1e-6


class MotorParams(NamedTuple):
    """Constants of the device; an infinite limit switches the limit off."""

    speed_gain_rad_per_s_v: float  # Km
    screw_m_per_rad: float  # Kp
    time_constant_s: float  # Tm
    servo_gain_v_per_m: float  # G
    friction_torque_n_m: float  # tau_f, at rest and in motion
    armature_resistance_ohm: float  # R
    voltage_limit_v: float
    torque_limit_n_m: float
    position_min_m: float
    position_max_m: float

    def closed_loop_coefficients(self) -> tuple[float, float]:
        """Return (a2_per_s2, b_per_s) of M(s) = a^2 / (s^2 + b s + a^2), Eq. 2."""
        b = 1.0 / self.time_constant_s
        return self.servo_gain_v_per_m * self.speed_gain_rad_per_s_v * self.screw_m_per_rad * b, b


class MotorState(NamedTuple):
    """Arm position and velocity along x, towards the sample."""

    position_m: float
    velocity_m_per_s: float


class MotorInputs(NamedTuple):
    """Command of the drive: a mode code (MODE_*) and, for position mode, the reference r [m]."""

    mode: int
    position_reference_m: float


class MotorOutputs(NamedTuple):
    """Voltage of the drive at the end of the step, and its force, after its limits; the limits that acted.

    force_n is the motor's torque through the screw, K_t i / Kp: an ideal force at the arm, which friction takes.
    """

    voltage_v: float
    force_n: float
    end_stop: bool
    voltage_limited: bool
    torque_limited: bool


class _Servo(NamedTuple):
    """Coefficients of the equation of motion, all in the linear coordinate of the arm."""

    mode: int
    target: float  # r [m]
    gain: float  # G [V/m]
    k: float  # Km Kp, no-load speed per volt [m/(s V)]
    b: float  # 1/Tm [1/s]
    a2: float  # a^2 [1/s^2]
    friction: float  # V_f [V]
    max_voltage: float  # [V]
    max_drop: float  # largest voltage across the armature resistance: torque limit times R Km [V]


@compiled
def _coefficients(params: MotorParams, inputs: MotorInputs) -> _Servo:
    k = params.speed_gain_rad_per_s_v * params.screw_m_per_rad
    b = 1.0 / params.time_constant_s
    volts_per_torque = params.armature_resistance_ohm * params.speed_gain_rad_per_s_v  # R / K_t
    # In mode off the motor is shorted and brakes without the drive, so the current limit does not apply.
    max_torque = params.torque_limit_n_m if inputs.mode == MODE_POSITION else math.inf
    return _Servo(
        mode=inputs.mode,
        target=inputs.position_reference_m,
        gain=params.servo_gain_v_per_m,
        k=k,
        b=b,
        a2=params.servo_gain_v_per_m * k * b,
        friction=params.friction_torque_n_m * volts_per_torque,
        max_voltage=params.voltage_limit_v,
        max_drop=max_torque * volts_per_torque,
    )


@compiled
def _command(servo: _Servo, x: float) -> float:
    """Return the voltage [V] of the servo before limits; zero when off."""
    return servo.gain * (servo.target - x) if servo.mode == MODE_POSITION else 0.0


@compiled
def _clip(value: float, limit: float) -> float:
    # In a node this takes half the time of `min` with `max`.
    return limit if value > limit else max(value, -limit)


@compiled
def _reverses(before: float, after: float) -> bool:
    return (before > 0.0 and after < 0.0) or (before < 0.0 and after > 0.0)


@compiled
def _transition(a2: float, b: float, t: float) -> tuple[float, float]:
    """Return C = e^(-bt/2) cosh(wt) and S = e^(-bt/2) sinh(wt) / w, which solve y'' + b y' + a2 y = 0 over t."""
    half = 0.5 * b
    discriminant = half * half - a2
    if discriminant > 0.0:
        w = math.sqrt(discriminant)
        # The slow exponential times one difference avoids cancellation near critical damping and overflow far from it.
        slow = math.exp(-a2 / (half + w) * t)
        gap = -math.expm1(-2.0 * w * t)
        return slow * (1.0 - 0.5 * gap), slow * gap / (2.0 * w)
    decay = math.exp(-half * t)
    if discriminant == 0.0:
        return decay, decay * t
    w = math.sqrt(-discriminant)
    return decay * math.cos(w * t), decay * math.sin(w * t) / w


@compiled
def _stop_time(a2: float, b: float, e: float, v: float) -> float:
    """Return the first time [s] at which y'' + b y' + a2 y = 0 from (e, v) stands still; v must reverse later."""
    half = 0.5 * b
    discriminant = half * half - a2
    slope = a2 * e + half * v
    if discriminant > 0.0:
        w = math.sqrt(discriminant)
        ahead, behind = slope + w * v, slope - w * v
        # The signs differ only if rounding alone made the reversal: then the stop lies beyond the step.
        return 0.5 * math.log(ahead / behind) / w if ahead * behind > 0.0 else math.inf
    if discriminant == 0.0:
        return v / slope
    w = math.sqrt(-discriminant)
    return math.atan2(w * abs(v), math.copysign(slope, slope * v)) / w


@compiled
def _move_servo(
    servo: _Servo, x: float, v: float, friction: float, t: float, c: float, s: float
) -> tuple[float, float, float]:
    """Linear servo (Eq. 2) towards the point where it balances friction; (c, s) is `_transition` over t."""
    half = 0.5 * servo.b
    balance = servo.target - friction / servo.gain
    e = x - balance
    end = -servo.a2 * s * e + (c - half * s) * v
    if servo.friction == 0.0 or not _reverses(v, end):
        return balance + (c + half * s) * e + s * v, end, t
    stop = min(_stop_time(servo.a2, servo.b, e, v), t)
    c, s = _transition(servo.a2, servo.b, stop)
    return balance + (c + half * s) * e + s * v, 0.0, stop


@compiled
def _move_voltage(servo: _Servo, x: float, v: float, voltage: float, t: float) -> tuple[float, float, float]:
    """Constant net voltage (off, or at the supply): the speed relaxes to k u with Tm (Eq. 1)."""
    final = servo.k * voltage
    change = -math.expm1(-servo.b * t)
    end = v + (final - v) * change
    if servo.friction > 0.0 and _reverses(v, end):
        t = min(math.log1p(-v / final) / servo.b, t)
        return x + final * t - (final - v) * (-v / (final - v)) / servo.b, 0.0, t
    return x + final * t - (final - v) * change / servo.b, end, t


@compiled
def _move_torque(servo: _Servo, x: float, v: float, voltage: float, t: float) -> tuple[float, float, float]:
    """Constant net torque (current limit): constant acceleration."""
    acceleration = servo.k * servo.b * voltage
    end = v + acceleration * t
    if servo.friction > 0.0 and _reverses(v, end):
        t = -v / acceleration
        end = 0.0
    return x + (v + 0.5 * acceleration * t) * t, end, t


@compiled
def _segment(servo: _Servo, x: float, v: float, t: float, c: float, s: float) -> tuple[float, float, float]:
    """Move for t or until the shaft comes to rest: (position, velocity, time used)."""
    command = _command(servo, x)
    voltage = _clip(command, servo.max_voltage)
    drop = voltage - v / servo.k
    armature = _clip(drop, servo.max_drop)
    if abs(v) <= CREEP_M_PER_S and abs(armature) <= servo.friction * BREAKAWAY:
        return x, 0.0, t
    friction = math.copysign(servo.friction, v if v != 0.0 else armature)
    if armature != drop:
        return _move_torque(servo, x, v, armature - friction, t)
    if servo.mode != MODE_POSITION or voltage != command:
        return _move_voltage(servo, x, v, voltage - friction, t)
    return _move_servo(servo, x, v, friction, t, c, s)


@compiled
def _substep(servo: _Servo, x: float, v: float, t: float, c: float, s: float) -> tuple[float, float]:
    x, v, used = _segment(servo, x, v, t, c, s)
    if used < t:
        # The shaft came to rest within t: for the rest of the time it sticks or moves the other way.
        rest = t - used
        c, s = _transition(servo.a2, servo.b, rest)
        x, v, used = _segment(servo, x, v, rest, c, s)
    return x, v


@compiled
def _is_limited(servo: _Servo, x: float, v: float) -> bool:
    command = _command(servo, x)
    voltage = _clip(command, servo.max_voltage)
    return voltage != command or abs(voltage - v / servo.k) > servo.max_drop


@compiled
def _advance(servo: _Servo, x: float, v: float, t: float, c: float, s: float) -> tuple[float, float]:
    """Advance by t [s] in one piece if no limit acts at its ends, else in fine ones; (c, s) is `_transition` over t."""
    if not _is_limited(servo, x, v):
        end_x, end_v = _substep(servo, x, v, t, c, s)
        if not _is_limited(servo, end_x, end_v):
            return end_x, end_v
    count = max(LIMITED_SUBSTEPS, math.ceil(4.0 * servo.b * t))
    h = t / count
    c, s = _transition(servo.a2, servo.b, h)
    for _ in range(count):
        x, v = _substep(servo, x, v, h, c, s)
    return x, v


@compiled
def _outputs(params: MotorParams, servo: _Servo, x: float, v: float) -> MotorOutputs:
    command = _command(servo, x)
    voltage = _clip(command, servo.max_voltage)
    back_emf = v / servo.k
    armature = _clip(voltage - back_emf, servo.max_drop)
    torque_limited = armature != voltage - back_emf
    torque = armature / (params.armature_resistance_ohm * params.speed_gain_rad_per_s_v)
    return MotorOutputs(
        armature + back_emf if torque_limited else voltage,
        torque / params.screw_m_per_rad,
        x <= params.position_min_m or x >= params.position_max_m,
        voltage != command,
        torque_limited,
    )


@compiled
def step(params: MotorParams, state: MotorState, inputs: MotorInputs, dt: float) -> tuple[MotorState, MotorOutputs]:
    """Advance the device by dt with the reference held (Eq. 1-2, E1; friction and limits as in the module's text).

    Without friction and limits the result is exact for any dt. Stick and slip are located in closed form, so it stays
    exact with friction: a shaft at rest moves no bit until |u| exceeds V_f by a millionth. The step notices that it
    reaches or leaves a voltage or torque limit at the next fine sub-step (at most 0.25 ms), with an error of second
    order in its length. An end stop sets the speed to zero.

    Args:
        params: The parameters of the device.
        state: The state before the step.
        inputs: The inputs. Any mode other than position means a drive voltage of zero (the safe state): the shorted
            motor brakes and the screw stands.
        dt: The time of the step [s], > 0.
    """
    servo = _coefficients(params, inputs)
    count = max(1, math.ceil(dt / SUBSTEP_S - 1e-9))
    h = dt / count
    c, s = _transition(servo.a2, servo.b, h)
    x, v = state.position_m, state.velocity_m_per_s
    for _ in range(count):
        x, v = _advance(servo, x, v, h, c, s)
        if x > params.position_max_m or x < params.position_min_m:
            x = min(max(x, params.position_min_m), params.position_max_m)
            v = 0.0
    return MotorState(x, v), _outputs(params, servo, x, v)

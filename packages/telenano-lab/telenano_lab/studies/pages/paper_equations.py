"""The results of the paper's equations for device, cantilever and control, as rows of the table of `reproduce`.

A row has the quantity, its place in the paper with the erratum, our value and the expected value, and their unit. The
expected values were computed from the equations independently of this project, with the errata corrected.
"""

import math
from typing import NamedTuple

import numpy as np

from telenano import Session, simulate
from telenano.afm import MaugisDugdale, damping_at
from telenano.sections import LAWS, AfmConfig, ControllerConfig, HapticConfig
from telenano_lab.studies.loops.theory import critical_delay_s, loop_model
from telenano_lab.studies.pages.motor_theory import bandwidth_hz, closed_loop_poles


class Row(NamedTuple):
    """One quantity: its name, its place in the paper with the erratum, our value, the expected one, and the unit."""

    name: str
    where: str
    ours: float
    expected: float
    unit: str


def device_rows() -> list[Row]:
    """Return rows for poles and bandwidth of the haptic device (Eq. 1-2)."""
    printed = HapticConfig.model_validate({"device": {"preset": "paper_gain"}}).device.to_params()
    ours = HapticConfig().device.to_params()
    slow, fast = (pole.real for pole in closed_loop_poles(printed))
    return [
        Row("slower pole with the printed G = 10 000", "Eq. 1-2, E1", slow, -8.281, "rad/s"),
        Row("faster pole with the printed G", "Eq. 1-2, E1", fast, -900.8, "rad/s"),
        Row("bandwidth with the printed G", "Eq. 2, E1", bandwidth_hz(printed), 1.318, "Hz"),
        Row("bandwidth with G = 1.917e5", "Eq. 2, E1", bandwidth_hz(ours), 30.0, "Hz"),
    ]


def cantilever_rows() -> list[Row]:
    """Return rows for the cantilever's mass and damping (Eq. 4), the Hamaker constant, and the meniscus (Eq. 6)."""
    # Table 2 has no viscosity; 1 Pa s makes the damping coefficient visible.
    wet = AfmConfig.model_validate(
        {"tip_sample": {"liquid_viscosity_pa_s": 1.0, "sample_viscosity_pa_s": 1.0}}
    ).to_dynamic()
    tip = AfmConfig().to_params().plant.tip
    width, a0 = tip.meniscus_width_m, tip.contact_distance_m
    forming = tip.bridge(width)[0]
    as_printed = AfmConfig.model_validate({"mode": "as_printed", "tip_sample": {"break_distance_m": 4e-9}})
    printed = as_printed.to_params().plant.tip.bridge(a0, retracting=True)[0]
    return [
        # Expected for silica, water and mica, with 4, 0.37 and 1.35e-19 J.
        Row("Hamaker constant across water", "Eq. 5", AfmConfig().tip_sample.hamaker_j * 1e20, 18.861, "1e-20 J"),
        Row("effective mass m", "Eq. 4", wet.mass_kg * 1e12, 45.032, "ng"),
        Row("damping 2 m b in air", "Eq. 4", wet.damping_kg_per_s * 1e9, 424.41, "nN s/m"),
        Row("damping in the middle of the liquid layer, for 1 Pa s", "Eq. 4, E2",
            damping_at(wet.viscosity, 0.4e-9) * 1e9, 15.708, "nN s/m"),
        Row("damping of the sample at 0.5 nm of indentation, for 1 Pa s", "Eq. 4",
            damping_at(wet.viscosity, a0 - 0.5e-9) * 1e9, 15.708, "nN s/m"),
        Row("distance at which the meniscus forms", "Eq. 6, E3", width * 1e9, 2.4, "nm"),
        Row("its force there", "Eq. 6, E3", forming * 1e9, -4.784, "nN"),
        Row("retract law as printed, at a0", "Eq. 6, E4", printed * 1e9, -3.340, "nN"),
    ]  # fmt: skip


def contact_rows() -> list[Row]:
    """Return rows for the pull-off force of the dimensionless Maugis-Dugdale contact, between DMT and JKR."""
    published = ((0.1, -1.9506), (0.5, -1.7182), (1.0, -1.6007), (5.0, -1.5063))
    return [
        Row(f"pull-off for lambda = {value:g}, in pi omega R", "Eq. 7-11, E6",
            MaugisDugdale(value, 1.0, 1.0, 1.0).pull_off()[0], expected, "")
        for value, expected in published
    ]  # fmt: skip


def _servo_gain(frequency_hz: float) -> float:
    """Return |M| of the haptic device at a frequency (Eq. 2), from its poles."""
    slow, fast = closed_loop_poles(HapticConfig().device.to_params())
    s = 2j * math.pi * frequency_hz
    return abs(slow * fast / ((s - slow) * (s - fast)))


def _felt_m_per_s(feature_m: float, bandwidth_hz: float) -> float:
    """Return the fastest scan at which features of a length [m] are felt through a bandwidth [Hz] (Eq. 14)."""
    path = {"program": "tactile", "tactile": {"feature_m": feature_m, "bandwidth_hz": bandwidth_hz}}
    begin = AfmConfig.model_validate({"begin": path}).begin
    assert begin is not None
    return float(begin.settings_of("tactile").felt_speed_m_per_s)


def _scaled_n_per_m(scale: float, stiffness_n_per_m: float) -> float:
    """Return the stiffness of a cantilever that the hand feels at an impedance scale (Eq. 13)."""
    tactile = {"scaling": "impedance", "impedance_scale": scale, "cantilever_stiffness_n_per_m": stiffness_n_per_m}
    controller = ControllerConfig.model_validate({"law": "tactile", "tactile": tactile})
    return float(controller.params().spring_n_per_m)


def control_rows() -> list[Row]:
    """Return rows for scaling, scan speed, and the bilateral loop: its delay margins, and Fig. 12 in lockstep."""
    law = LAWS["virtual_impedance"].config()
    values = law.model_dump()
    scale, force = values["position_scale"], values["force_scale"]
    rows = [
        *(Row(f"x_m over x_s at {hz} Hz", "Eq. 16, E1, E8", _servo_gain(hz) / scale * 1e-6, expected, "mm/nm")
          for hz, expected in ((3, 0.66356), (10, 0.63417), (30, 0.47131), (100, 0.15272))),
        Row("force at the hand for 10 nN", "Eq. 12", 10e-9 * force, 1.0, "N"),
        Row("stiffness at the hand of 40 N/m, for alpha_p = 1e4", "Eq. 13",
            _scaled_n_per_m(1e4, 40.0) * 1e-9, 4.0, "GN/m"),
        Row("scan speed for 1 nm and 30 Hz", "Eq. 14", _felt_m_per_s(1e-9, 30.0) * 1e9, 30.0, "nm/s"),
        Row("way of the hand for the gap of 10 nm", "Eq. 12, E8", 10e-9 / scale * 1e3, 6.667, "mm"),
        Row("the same with the printed alpha_p in m/m", "Eq. 12, E8", 10e-9 / 15e-9 * 1e3, 666.7, "mm"),
    ]  # fmt: skip
    for stiffness, expected in ((10.0, 95.05), (20.0, 45.51), (38.0, 22.44)):
        loop = loop_model("virtual_impedance", law, stiffness)
        assert loop is not None
        row = Row(f"delay margin against {stiffness:g} N/m", "Eq. 15-17", 1e3 * critical_delay_s(loop), expected, "ms")
        rows.append(row)
    return rows + _fig12_rows(simulate("fig12"))


def _fig12_rows(session: Session) -> list[Row]:
    """Return rows for Fig. 12 from a session in simulated time."""
    time, hand = session["time_s"], session["operator_force_n"]
    tip = session["scaled_tip_force_n"]
    # The last half second of the second hold; the end of the session is long after the release.
    held = (time > 4.0) & (time < 4.5)
    ratio = float(np.mean(hand[held]) / np.mean(tip[held]))
    return [
        Row("F_m over alpha_f F_s while the hand presses with 2 N", "Eq. 15-17", ratio, 1.05, ""),
        Row(
            "place of the hand after its release", "Eq. 15-17, E8", 1e2 * float(session["reference_m"][-1]), 0.703, "cm"
        ),
        Row("largest pull on the tip", "Eq. 4-11", 1e9 * float(session["tip_force_n"].min()), -12.5, "nN"),
    ]

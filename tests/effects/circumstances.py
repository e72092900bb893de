"""The sessions in which keys act that do nothing while a hand presses the tip onto mica, and values without a range."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from compared_sessions import Session, Timed, command
from telenano_lab.microscopy.image_files import Image, write_gwy

from telenano.settings.config import merge
from telenano.virtual import VirtualRig
from telenano.wire.examples import example

# A hand that goes across while it presses, on a tip with friction.
ACROSS: Mapping[str, Any] = {
    "haptic_node": {
        "lateral": {"path": [{"time_s": 0.1, "x_m": 0.0}, {"time_s": 0.4, "x_m": 8e-3, "y_m": 4e-3}]},
    },
    "controller": {"lateral": {"mode": "rate"}},
    "afm_node": {"friction": {"coefficient": 0.3}},
}
COURSE = [{"time_s": 0.0, "x_m": 0.0}, {"time_s": 0.2, "x_m": 5e-3}]
# Files that the link reads, by their names.
FILES: Mapping[str, str] = {
    "delays.txt": "0 0.002\n1 0.02\n2 0.004\n",
    "other_delays.txt": "0 0.01\n1 0.0\n",
    "lost.txt": "0 0\n1 1\n2 0\n",
    "other_lost.txt": "0 1\n1 0\n",
    "other_delivered.txt": "".join(f"{n}\n" for n in range(1, 400, 5)),
    "delivered.txt": "".join(f"{n}\n" for n in range(1, 400, 2)),
    "jitter.txt": "-1.0 0.0 0.5 1.0\n",
    "other_jitter.txt": "-1.0 0.0 2.0 3.0\n",
}
DOTS = {"sample": {"name": "dots"}, "cantilever": {"stiffness_n_per_m": 1.0}}
SCAN = {
    "program": "scan",
    "scan": {"approach_m_per_s": 1e-6, "settle_s": 0.02, "dwell_s": 0.01, "pixels": 4, "lines": 2},
}
CURVE = {"program": "curve", "curve": {"speed_m_per_s": 1e-6}}
TACTILE = {"program": "tactile", "tactile": {"approach_m_per_s": 1e-6, "speed_m_per_s": 1e-7}}
DYNAMIC = {"model": "dynamic", "cantilever": {"resonance_hz": 20e3, "quality": 10.0, "stiffness_n_per_m": 40.0}}


def both_ways(block: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings of a link that does the same in both directions."""
    return {"delay_node": {"forward": block, "backward": block}}


def afm(*sections: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings of the instrument."""
    return {"afm_node": merge(*map(dict, sections))}


def sent(src: str, topic: str, **fields: Any) -> Any:
    """Return what publishes a message, an example of its topic with some fields changed."""

    def publish(rig: VirtualRig) -> None:
        body = msgspec.structs.asdict(example(topic, **fields))
        rig.endpoint(src).publish(topic, **{name: value for name, value in body.items() if name not in _HEADER})

    return publish


_HEADER = ("seq", "t_ns", "src", "v")
JITTER = {"delay_s": 0.02, "jitter": {"scale_s": 0.003}}
RECORDED = Session(are_files=True)
# So small that a session of a second fills them.
SMALL = {"compression": "none", "chunk_size_bytes": 4096}
VALUES: Mapping[str, Sequence[Any]] = {
    "duration_s": [1.5],
    "recorder.directory": ["below"],
    "recorder.file_name": ["other.mcap"],
    "recorder.topics": [["afm/*"]],
    "recorder.exclude": [["afm/*"]],
    "recorder.split_size_bytes": [65_536],
    "recorder.split_interval_s": [1.0],
    "recorder.quota_bytes": [100_000],
    "recorder.quota_policy": ["drop_oldest"],
    "haptic_node.device.voltage_limit_v": [7.0],
    "haptic_node.device.position_min_m": [-1e-5],
    "haptic_node.device.position_max_m": [1e-4],
    "haptic_node.device.start_position_m": [0.001],
    "haptic_node.limits.position_min_m": [-1e-4],
    "controller.hand_limits.position_min_m": [-1e-4],
    "controller.hand_limits.position_max_m": [1e-3],
    "controller.hand_limits.max_speed_m_per_s": [1e-3],
    "haptic_node.lateral.max_force_n": [0.2],
    "delay_node.*.slots.max_interval_s": [0.02],
    "delay_node.*.outage.period_s": [0.4],
    "delay_node.*.outage.mean_up_s": [0.1],
    "delay_node.*.outage.mean_down_s": [0.02],
    "delay_node.*.jitter.second_correlation_share": [0.5],
    "afm_node.cantilever.steps_per_period": [192],
    "afm_node.disturbances.drift.wander_m_per_s": [1e-8],
    "afm_node.begin.push.lateral_limit_n": [1e-9],
    "afm_node.feel.table": [[[-2.0, 0.0], [-28.0, 1e-9]]],
    "afm_node.feel.tolerance": [5.0],
    "afm_node.feel.slope_limit_n_per_unit": [1e-11],
    "afm_node.feel.least_n": [-1e-9],
    "controller.bounded_model.force_margin_n": [1.0],
    "controller.bounded_model.exchange_s": [0.5],
    "afm_node.sample.pixels": [64],
    "afm_node.sample.dot_count": [5],
    "afm_node.sample.map": ["shift.npz"],
    "afm_node.sample.channel": ["Retrace"],
    "afm_node.sample.level": ["absolute"],
    "afm_node.sample.particles.places": [[[3e-7, 0.0]]],
    "afm_node.sample.particles.motion": ["roll", "auto"],
    "afm_node.safety.lateral_limit_n": [1e-9],
    "afm_node.lateral.reach_m": [1e-9],
    "afm_node.lateral.speed_m_per_s": [1e-8],
    "instrument": ["real"],
    "haptic_node.lateral.path": [COURSE],
    "haptic_node.impedance.lateral_path": [COURSE],
    "haptic_node.operator[force_profile].points": [[{"time_s": 0.1, "force_n": 1.0}]],
    "haptic_node.operator[reacting].points": [[{"time_s": 0.1, "force_n": 3.0}]],
    "haptic_node.operator[impedance].path": [[{"time_s": 0.1, "position_m": 1e-3}]],
    "controller.switch_limit_s": [0.1],
    "controller.refused_laws": [{"wave": "is too slow for it"}],
    "delay_node.profile": ["lte"],
    "delay_node.*.jitter.table_file": ["jitter.txt", "other_jitter.txt"],
    "delay_node.*.jitter.quantiles": [[[0.0, 0.001], [1.0, 0.004]]],
    "delay_node.*.delay_trace.file": ["delays.txt", "other_delays.txt"],
    "delay_node.*.loss_trace.file": ["lost.txt", "other_lost.txt"],
    "delay_node.*.delivery_trace.file": ["delivered.txt", "other_delivered.txt"],
    "delay_node.*.outage.schedule": [[[0.2, 0.1]]],
    "delay_node.*.topics": [{"teleop/*": {"delay_s": 0.02}}],
    "delay_node.*.reliable": [["teleop/*", "session/*"]],
    "afm_node.sample.name": ["flat", "grating"],
}


def write_files(folder: Path) -> None:
    """Write the files that the sessions read: of the link, heights of a sample, and a map of a frequency shift."""
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    z = np.linspace(0.0, 12e-9, 601)
    shift = -30.0 * (z / 2e-9) * np.exp(1.0 - z / 2e-9)
    np.savez(
        folder / "shift.npz", value=shift[None, None], unit="Hz", x=np.zeros(1), y=np.zeros(1), z=z, length_unit="m"
    )
    x = np.linspace(0.0, 1.0, 32)
    heights = 1e-9 * (2.0 + np.sin(9.0 * x)[:, None] * np.cos(7.0 * x)[None, :])
    image = Image("Height", "m", heights, 160e-9, 160e-9)
    retrace = image._replace(title="Retrace Height", values=2.0 * heights)
    write_gwy(folder / "heights.gwy", {"height": image, "retrace": retrace})


LOSES = {"loss": {"probability": 0.3}}
NARROW = {"rate": {"rate_bytes_per_s": 40e3}, "queue": {"limit_messages": 10}}
PULLED = Session(
    {"haptic_node": {"operator": {"kind": "interactive"}, "lateral": {}}, "controller": {"lateral": {"mode": "rate"}}},
    happens=tuple(
        Timed(0.5 + 0.05 * n, sent("viz_node@master", "operator/force", force_n=(1.0, 0.0, -1.0))) for n in range(4)
    ),
)
PULLS_BACK = Session(
    {
        "haptic_node": {
            "limits": {"position_min_m": -1e-5, "max_speed_m_per_s": 5e-3},
            "operator": {"points": [{"time_s": 0.05, "force_n": -3.0}]},
        }
    }
)
# A servo so stiff that the handle passes its limit, where the end stop of the device may stand.
OVERSHOOTS = Session(
    {
        "haptic_node": {
            "device": {"servo_gain_v_per_m": 1e6},
            "limits": {"position_min_m": -1e-5, "max_speed_m_per_s": 0.03},
            "operator": {"points": [{"time_s": 0.05, "force_n": -3.0}]},
        }
    }
)
TAPPING = {"program": "scan", "scan": {**SCAN["scan"], "mode": "tapping", "gain_per_s": 100.0}}
TAPS = Session(afm(DYNAMIC, {"begin": TAPPING}), is_started=False, end_s=2.5)
# The other half falls silent for longer than any law waits by default.
SILENT = Session(happens=(Timed(0.5, lambda rig: rig.stall("controller@slave", 0.8)),), end_s=1.6)
# The half beside the instrument falls silent, so long that the tip is held, or so long that it is retracted.
HELD_TIP = Session(happens=(Timed(0.4, lambda rig: rig.stall("controller@slave", 0.15)),))
RETRACTED_TIP = Session(happens=(Timed(0.4, lambda rig: rig.stall("controller@slave", 0.8)),), end_s=1.6)
# The simulated device of the package telenano-devices, which shows a force.
HELD = Session(
    {"haptic_node": {"driver": "simulated_impedance", "coupling": {"rest_s": 0.02}}}, rate_hz=1000.0, end_s=1.0
)
HELD_ACROSS = replace(
    HELD,
    settings=merge(
        dict(HELD.settings),
        {
            "haptic_node": {"impedance": {"lateral_path": COURSE}, "coupling": {"lateral_stiffness_n_per_m": 200.0}},
            "controller": {"lateral": {"mode": "rate"}},
        },
    ),
)
FEEL = {
    "channel": "frequency_shift", "unit": "Hz", "table": [[-2.0, 0.0], [-28.0, 3e-9]], "tolerance": 0.1,
    "slope_limit_n_per_unit": 1e-9,
}  # fmt: skip
# A tip that pushes a particle of the package telenano-lab and loses it.
PARTICLE: Mapping[str, Any] = {
    "haptic_node": {
        "operator": {
            "kind": "force_profile",
            "points": [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.1, "force_n": 1.0}],
        },
        "lateral": {"path": [{"time_s": 0.3, "x_m": 0.0}, {"time_s": 0.4, "x_m": 12e-3, "y_m": 3e-3}]},
    },
    "controller": {
        "virtual_impedance": {"position_scale": 1e-5},
        "lateral": {"mode": "rate", "speed_m_per_s": 2e-6, "rate_per_s": 1e-4},
    },
    "afm_node": {
        "cantilever": {"stiffness_n_per_m": 0.1},
        "meniscus": False,
        "sample": {"name": "flat", "size_m": 8e-6, "pixels": 16, "particles": {"places": [[3.5e-7, 0.0]]}},
        "safety": {
            "base_min_m": -1.2e-6, "retract_position_m": -0.7e-6, "base_max_m": 0.3e-6, "base_speed_m_per_s": 20e-6,
            "retract_speed_m_per_s": 20e-6, "lateral_limit_n": 0.5e-6,
        },
    },
}  # fmt: skip

PUSH = {
    "program": "push",
    "push": {"x0_m": 0.0, "y0_m": 0.0, "x1_m": 4e-7, "y1_m": 0.0, "approach_m_per_s": 5e-6, "mode": "straight"},
}
PUSHES = Session(merge(dict(PARTICLE), {"afm_node": {"begin": PUSH}}), is_started=False, end_s=1.6)
# A push beside the middle of the particle, which slips off the tip.
SLIPS = replace(
    PUSHES,
    settings=merge(
        dict(PUSHES.settings), {"afm_node": {"begin": {"push": {"y0_m": 2e-7, "y1_m": 2e-7, "x1_m": 2e-6}}}}
    ),
    end_s=2.6,
)
# A hand that throws the handle and then lets it coast, far from the sample.
COASTS = Session(
    {
        "haptic_node": {
            "operator": {
                "points": [
                    {"time_s": 0.05, "force_n": 0.0},
                    {"time_s": 0.06, "force_n": 2.0},
                    {"time_s": 0.12, "force_n": 2.0},
                    {"time_s": 0.13, "force_n": 0.0},
                ]
            }
        },
        "afm_node": {"rest_distance_m": 1e-7},
    }
)
# A cantilever so soft that a press takes more energy than the tip has at first.
SOFT_PRESS = Session(
    merge(
        dict(both_ways({"delay_s": 0.02})),
        {
            "controller": {"bounded_model": {"start_energy_j": 1e-5}},
            "afm_node": {
                "cantilever": {"stiffness_n_per_m": 1.0},
                "safety": {"base_max_m": 1e-6, "base_speed_m_per_s": 2e-5},
            },
            "haptic_node": {
                "operator": {
                    "points": [
                        {"time_s": 0.05, "force_n": 0.0},
                        {"time_s": 0.06, "force_n": 2.0},
                        {"time_s": 1.0, "force_n": 2.0},
                        {"time_s": 1.1, "force_n": 0.2},
                        {"time_s": 1.6, "force_n": 2.0},
                    ]
                }
            },
        },
    ),
    end_s=2.5,
)
SESSIONS: Sequence[tuple[str, Session]] = (
    ("duration_s", Session(are_files=True, is_conducted=True)),
    ("recorder.*", RECORDED),
    *(
        (f"recorder.{name}", replace(RECORDED, settings={"recorder": {**SMALL, **more}}))
        for name, more in {
            "split_size_bytes": {},
            "quota_bytes": {},
            "quota_policy": {"quota_bytes": 140_000, "split_size_bytes": 65_536},
        }.items()
    ),
    ("controller.period_s", Session(rate_hz=None)),
    ("controller.refused_laws", Session(happens=(command(0.5, "set", "controller", law="wave"),))),
    (
        "controller.switch_limit_s",
        Session(
            happens=(
                Timed(0.5, lambda rig: rig.stall("controller@slave", 5.0)),
                command(0.52, "set", "controller@master", law="wave"),
            )
        ),
    ),
    ("controller.deadband.wave_floor_sqrt_w", Session({"controller": {"law": "wave"}})),
    ("controller.lateral.**", Session(ACROSS)),
    ("haptic_node.lateral.**", Session(ACROSS)),
    (
        "controller.lateral.disc.radius_m",
        Session(merge(dict(ACROSS), {"controller": {"lateral": {"disc": {"x_m": 4e-7}}}})),
    ),
    (
        "haptic_node.operator[interactive].**",
        Session(happens=(Timed(0.6, sent("viz_node@master", "operator/force", force_n=(0.0, 0.0, -1.0))),)),
    ),
    ("haptic_node.allow_replay", Session(happens=(Timed(0.5, sent("controller@master", "node/health", replay=True)),))),
    ("afm_node.allow_replay", Session(happens=(Timed(0.5, sent("controller@slave", "node/health", replay=True)),))),
    ("delay_node.seed", Session(both_ways(JITTER))),
    ("delay_node.*.jitter.**", Session(both_ways(JITTER))),
    *(
        (
            f"delay_node.*.jitter.{name}",
            Session(both_ways({"jitter": {"scale_s": 0.003, **more}})),
        )
        for name, more in {
            "second_correlation_time_s": {
                "correlation_time_s": 0.1,
                "second_correlation_time_s": 0.02,
                "second_correlation_share": 0.5,
            },
            "second_correlation_share": {"correlation_time_s": 0.1, "second_correlation_time_s": 0.02},
            "pareto_shape": {"distribution": "pareto"},
            "second_scale_s": {"distribution": "hyperexponential", "second_share": 0.5, "second_scale_s": 0.01},
            "second_share": {"distribution": "hyperexponential", "second_share": 0.2, "second_scale_s": 0.01},
            "table_file": {"distribution": "table", "table_file": "jitter.txt"},
            "quantiles": {"distribution": "table", "quantiles": [[0.0, 0.0], [1.0, 1.0]]},
        }.items()
    ),
    *(
        (f"delay_node.*.{name}.**", Session(both_ways({"delay_s": 0.01, name: {"probability": 0.2}})))
        for name in ("loss", "corruption", "duplication", "reordering")
    ),
    (
        "delay_node.*.markov_loss.**",
        Session(both_ways({"markov_loss": {"p13": 0.2, "p31": 0.4, "p32": 0.3, "p23": 0.3}})),
    ),
    ("delay_node.*.order", Session(both_ways({"delay_s": 0.02, "jitter": {"scale_s": 0.01}}))),
    ("afm_node.sample.**", Session(afm(DOTS, {"begin": SCAN}), is_started=False, end_s=2.5)),
    ("afm_node.begin.scan.**", Session(afm(DOTS, {"begin": SCAN}), is_started=False, end_s=2.5)),
    ("afm_node.begin.curve.**", Session(afm(DOTS, {"begin": CURVE}), is_started=False, end_s=2.5)),
    ("afm_node.begin.tactile.**", Session(afm(DOTS, {"begin": TACTILE}), is_started=False, end_s=2.5)),
    # A tactile image along the way of a pointer begins above the place of the tip.
    (
        "afm_node.begin.lateral.**",
        Session(afm(DOTS, {"begin": merge(TACTILE, {"tactile": {"drive": "pointer"}})}), is_started=False, end_s=2.5),
    ),
    ("afm_node.begin.push.**", PUSHES),
    ("afm_node.safety.lateral_limit_n", Session(ACROSS)),
    ("afm_node.friction.**", Session(ACROSS)),
    ("afm_node.torsion.**", Session(ACROSS)),
    ("afm_node.cantilever.**", Session()),
    ("afm_node.cantilever.**", Session(afm(DYNAMIC))),
    ("afm_node.tip_sample.**", Session()),
    ("afm_node.tip_sample.**", Session(afm(DYNAMIC))),
    ("afm_node.lateral.**", Session(ACROSS)),
    (
        "haptic_node.device.**",
        Session(
            {"haptic_node": {"limits": {"position_min_m": -1e-5, "position_max_m": 1e-4, "max_speed_m_per_s": 5e-3}}}
        ),
    ),
    ("haptic_node.operator[reacting].**", Session(end_s=4.0)),
    ("haptic_node.lateral.free_damping_n_s_per_m", PULLED),
    ("haptic_node.disturbances.seed", Session({"haptic_node": {"disturbances": {"tremor": {"enabled": True}}}})),
    ("afm_node.disturbances.seed", Session(afm({"disturbances": {"vibration": {"enabled": True}}}))),
    ("afm_node.disturbances.drift.**", Session(afm(DOTS, {"begin": SCAN}), is_started=False, end_s=2.5)),
    ("afm_node.disturbances.drift.wander_m_per_s", Session(afm({"disturbances": {"drift": {"enabled": True}}}))),
    (
        "afm_node.disturbances.drift.wander_s",
        Session(afm({"disturbances": {"drift": {"enabled": True, "wander_m_per_s": 1e-8}}})),
    ),
    ("controller.lateral.lost_way_m", Session(PARTICLE, end_s=2.5)),
    ("controller.lateral.contact_n", Session(PARTICLE, end_s=2.5)),
    ("controller.passivity.force_margin_n", Session(both_ways({"delay_s": 0.1}), end_s=2.0)),
    ("delay_node.*.delay_trace.**", Session(both_ways({"delay_trace": {"file": "delays.txt"}}), end_s=3.5)),
    ("delay_node.*.loss_trace.**", Session(both_ways({"loss_trace": {"file": "lost.txt"}}), end_s=3.5)),
    ("delay_node.*.queue.**", Session(both_ways(NARROW))),
    ("delay_node.*.slots.**", Session(both_ways({"slots": {"min_interval_s": 0.01}}))),
    ("delay_node.*.outage.**", Session(both_ways({"outage": {"mean_up_s": 0.2, "mean_down_s": 0.05}}))),
    ("delay_node.*.outage.period_s", Session(both_ways({"outage": {"schedule": [[0.1, 0.05]]}}))),
    ("delay_node.*.reliable", Session(both_ways(LOSES))),
    ("afm_node.cantilever.**", Session(afm({"disturbances": {"readout": {"enabled": True}}}))),
    (
        "afm_node.tip_sample.sample_thickness_m",
        Session(afm(DYNAMIC, {"tip_sample": {"sample_viscosity_pa_s": 1.0}})),
    ),
    (
        "afm_node.sample.period_m",
        Session(afm(DOTS, {"sample": {"name": "grating"}, "begin": SCAN}), is_started=False, end_s=2.5),
    ),
    ("haptic_node.device.position_min_m", OVERSHOOTS),
    ("haptic_node.limits.position_min_m", PULLS_BACK),
    ("controller.hand_limits.position_min_m", PULLS_BACK),
    ("afm_node.sample.map", Session(afm({"feel": FEEL}))),
    *((f"haptic_node.{section}.**", HELD) for section in ("coupling", "impedance")),
    *((f"haptic_node.{section}.**", HELD_ACROSS) for section in ("coupling", "impedance")),
    *(
        (f"controller.{law}.silence_limit_s", SILENT)
        for law in (
            "virtual_impedance",
            "position_force",
            "wave",
            "passivity",
            "bounded_model",
            "four_channel",
            "fractal_impedance",
            "matched_wave",
            "model_mediated",
            "smith",
            "tdpa",
            "two_layer",
            "tactile",
        )
    ),
    *((f"afm_node.begin.scan.{name}", TAPS) for name in ("amplitude_m", "setpoint_share")),
    ("afm_node.cantilever.steps_per_period", TAPS),
    ("afm_node.begin.push.stop_on_loss", SLIPS),
    ("afm_node.torsion.gain_uncertainty", PUSHES),
    (
        "afm_node.friction.tip_height_m",
        Session(afm(DOTS, {"begin": SCAN, "friction": {"coefficient": 0.3}}), is_started=False, end_s=2.5),
    ),
    ("afm_node.safety.resume_acceleration_m_per_s2", HELD_TIP),
    *(
        (f"afm_node.safety.{name}", RETRACTED_TIP)
        for name in ("command_deadline_s", "hold_time_s", "retract_speed_m_per_s")
    ),
    ("controller.tactile.**", Session(afm(DOTS, {"begin": TACTILE}), end_s=2.5)),
    *(
        (f"controller.bounded_model.{name}", Session(both_ways({"delay_s": 0.1}), end_s=2.0))
        for name in ("lag_damping", "lag_inertia")
    ),
    ("controller.bounded_model.force_margin_n", COASTS),
    ("controller.bounded_model.exchange_s", SOFT_PRESS),
    ("afm_node.sample.particles.**", Session(PARTICLE, end_s=2.5)),
    *(
        (
            f"afm_node.sample.particles.{name}",
            Session(merge(dict(PARTICLE), {"afm_node": {"sample": {"particles": {"places": None}}}}), end_s=2.5),
        )
        for name in ("count", "seed")
    ),
    ("afm_node.sample.particles.places", Session(afm({"sample": {"particles": {}}}))),
    ("afm_node.feel.**", Session(afm({"feel": FEEL, "sample": {"map": "shift.npz"}}))),
    # A branch that goes on behind the turn of the map, and one that pulls.
    *(
        (f"afm_node.feel.{name}", Session(afm({"feel": {**FEEL, "table": table}, "sample": {"map": "shift.npz"}})))
        for name, table in {
            "tolerance": [[-2.0, 0.0], [-40.0, 3e-9]],
            "least_n": [[-2.0, 0.0], [-28.0, -3e-9]],
        }.items()
    ),
    (
        "afm_node.sample.channel",
        Session(afm(DOTS, {"sample": {"name": "heights.gwy"}, "begin": SCAN}), is_started=False, end_s=2.5),
    ),
    (
        "afm_node.sample.level",
        Session(afm(DOTS, {"sample": {"name": "heights.gwy"}, "begin": SCAN}), is_started=False, end_s=2.5),
    ),
)
# Keys that act in the dynamic model alone, whose sessions take most of a minute each: `make endurance` tries them.
COSTLY: Sequence[str] = (
    "afm_node.begin.scan.amplitude_m",
    "afm_node.begin.scan.setpoint_share",
    "afm_node.begin.scan.mode",
    "afm_node.cantilever.quality",
    "afm_node.cantilever.resonance_hz",
    "afm_node.cantilever.steps_per_period",
    "afm_node.tip_sample.liquid_thickness_m",
    "afm_node.tip_sample.liquid_viscosity_pa_s",
    "afm_node.tip_sample.sample_thickness_m",
    "afm_node.tip_sample.sample_viscosity_pa_s",
)
FAULTY_HAND = "acts on a device that jumps, freezes or runs away; packages/telenano-devices/tests/impedance"
# Keys that change nothing that a session in virtual time shows, each with the reason.
WITHOUT: Mapping[str, str] = {
    "name": "names folders, figures and tables",
    "description": "is a sentence for a person",
    "realtime.scheduler": "asks the system of a process for real time",
    "realtime.priority": "asks the system of a process for real time",
    "realtime.memory_lock": "asks the system of a process for real time",
    "realtime.cpus": "asks the system of a process for a processor",
    "realtime.processes": "puts nodes into processes, of which a session in lockstep or in virtual time has none",
    "realtime.huge_pages": "asks the system of a process for large pages",
    "haptic_node.serial.**": "a real handle; tests/unit/devices/test_serial_handle.py",
    "haptic_node.limits.max_force_n": "only a real device has a force mode; tests/unit/hand/test_haptic_safety.py",
    "haptic_node.coupling.needs_deadman": "only a real device has a button; packages/telenano-devices/tests/impedance",
    "haptic_node.coupling.deadman_age_s": "only a real device has a button; packages/telenano-devices/tests/impedance",
    "haptic_node.coupling.rest_m": FAULTY_HAND,
    "haptic_node.coupling.jump_m": FAULTY_HAND,
    "haptic_node.coupling.frozen_s": FAULTY_HAND,
    "haptic_node.coupling.frozen_force_n": FAULTY_HAND,
    "haptic_node.coupling.runaway_m_per_s": FAULTY_HAND,
    "haptic_node.simulated_impedance": "is empty: haptic_node.impedance has its keys",
    "haptic_node.haply.**": "a real device; packages/telenano-devices/tests/impedance",
    "haptic_node.dhd.**": "a real device; packages/telenano-devices/tests/impedance",
    "haptic_node.hd.**": "a real device; packages/telenano-devices/tests/impedance",
    "afm_node.modbus.**": "a real instrument; tests/unit/devices/test_modbus_stage.py",
    "afm_node.gwyscope.**": "a real instrument; packages/telenano-devices/tests/controllers",
    "afm_node.nanonis.**": "a real instrument; packages/telenano-devices/tests/controllers",
    "afm_node.attended": "a real instrument without a guard; packages/telenano-devices/tests/controllers",
    "recorder.sync_to_disk": "acts when the power is cut; tests/unit/recording/test_recording_writer.py",
    "recorder.far": "needs a network between two machines; tests/stack/test_two_sites.py",
    "recorder.fetch_kbit_per_s": "needs a network between two machines; tests/stack/test_fetched_recording.py",
    "viz_node.**": "a server with sockets; tests/unit/serving and tests/unit/viz_node",
}

"""The sessions in which keys act that do nothing while a hand presses the tip onto mica, and values without a range."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from sessions import Session, Timed, command

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
    "lost.txt": "0 0\n1 1\n2 0\n",
    "delivered.txt": "".join(f"{n}\n" for n in range(1, 400, 2)),
    "jitter.txt": "-1.0 0.0 0.5 1.0\n",
}
DOTS = {"sample": {"name": "dots"}, "cantilever": {"stiffness_n_per_m": 1.0}}
SCAN = {"program": "scan", "scan": {"approach_m_per_s": 1e-6, "settle_s": 0.02, "pixels": 4, "lines": 2}}
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
VALUES: Mapping[str, Sequence[Any]] = {
    "haptic_node.device.voltage_limit_v": [20.0],
    "haptic_node.device.position_min_m": [-0.0001],
    "haptic_node.device.position_max_m": [0.0002],
    "haptic_node.device.start_position_m": [0.001],
    "haptic_node.limits.position_min_m": [-0.0001],
    "haptic_node.lateral.max_force_n": [0.2],
    "delay_node.*.slots.max_interval_s": [0.02],
    "delay_node.*.outage.period_s": [0.4],
    "delay_node.*.outage.mean_up_s": [0.1],
    "delay_node.*.outage.mean_down_s": [0.02],
    "delay_node.*.jitter.second_correlation_share": [0.5],
    "afm_node.lateral.reach_m": [1e-9],
    "afm_node.lateral.speed_m_per_s": [1e-8],
    "instrument": ["real"],
    "haptic_node.lateral.path": [COURSE],
    "haptic_node.impedance.lateral_path": [COURSE],
    "haptic_node.operator[force_profile].points": [[{"time_s": 0.1, "force_n": 1.0}]],
    "haptic_node.operator[reacting].points": [[{"time_s": 0.1, "force_n": 1.0}]],
    "haptic_node.operator[impedance].path": [[{"time_s": 0.1, "position_m": 1e-3}]],
    "controller.switch_limit_s": [0.1],
    "controller.refused_laws": [{"wave": "is too slow for it"}],
    "delay_node.profile": ["lte"],
    "delay_node.*.jitter.table_file": ["jitter.txt"],
    "delay_node.*.jitter.quantiles": [[[0.0, 0.001], [1.0, 0.004]]],
    "delay_node.*.delay_trace.file": ["delays.txt"],
    "delay_node.*.loss_trace.file": ["lost.txt"],
    "delay_node.*.delivery_trace.file": ["delivered.txt"],
    "delay_node.*.outage.schedule": [[[0.2, 0.1]]],
    "delay_node.*.topics": [{"teleop/*": {"delay_s": 0.02}}],
    "delay_node.*.reliable": [["teleop/*", "session/*"]],
    "afm_node.sample.name": ["flat", "grating"],
}
LOSES = {"loss": {"probability": 0.3}}
NARROW = {"rate": {"rate_bytes_per_s": 40e3}, "queue": {"limit_messages": 10}}
PULLED = Session(
    {"haptic_node": {"operator": {"kind": "interactive"}, "lateral": {}}, "controller": {"lateral": {"mode": "rate"}}},
    happens=tuple(
        Timed(0.5 + 0.05 * n, sent("viz_node@master", "operator/force", force_n=(1.0, 0.0, -1.0))) for n in range(4)
    ),
)
# A tip that pushes a particle of the package telenano-assembly and loses it.
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

SESSIONS: Sequence[tuple[str, Session]] = (
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
    ("controller.lateral.disc.radius_m", Session(merge(dict(ACROSS), {"controller": {"lateral": {"disc": {"x_m": 4e-7}}}}))),
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
                "correlation_time_s": 0.1, "second_correlation_time_s": 0.02, "second_correlation_share": 0.5
            },
            "second_correlation_share": {"correlation_time_s": 0.1, "second_correlation_time_s": 0.02},
            "pareto_shape": {"distribution": "pareto"},
            "second_scale_s": {"distribution": "hyperexponential", "second_share": 0.5, "second_scale_s": 0.01},
            "table_file": {"distribution": "table", "quantiles": [[0.0, 0.0], [1.0, 1.0]]},
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
    ("afm_node.sample.**", Session(afm(DOTS, {"begin": SCAN}), is_started=False)),
    ("afm_node.begin.scan.**", Session(afm(DOTS, {"begin": SCAN}), is_started=False)),
    ("afm_node.begin.curve.**", Session(afm(DOTS, {"begin": CURVE}), is_started=False)),
    ("afm_node.begin.tactile.**", Session(afm(DOTS, {"begin": TACTILE}), is_started=False)),
    ("afm_node.friction.**", Session(ACROSS)),
    ("afm_node.torsion.**", Session(ACROSS)),
    ("afm_node.cantilever.**", Session()),
    ("afm_node.cantilever.**", Session(afm(DYNAMIC))),
    ("afm_node.tip_sample.**", Session()),
    ("afm_node.tip_sample.**", Session(afm(DYNAMIC))),
    ("afm_node.lateral.**", Session(ACROSS)),
    (
        "haptic_node.device.**",
        Session({"haptic_node": {"limits": {"position_min_m": -1e-5, "position_max_m": 1e-4, "max_speed_m_per_s": 5e-3}}}),
    ),
    ("haptic_node.operator[reacting].**", Session(end_s=4.0)),
    ("haptic_node.lateral.free_damping_n_s_per_m", PULLED),
    ("haptic_node.disturbances.seed", Session({"haptic_node": {"disturbances": {"tremor": {"enabled": True}}}})),
    ("afm_node.disturbances.seed", Session(afm({"disturbances": {"vibration": {"enabled": True}}}))),
    ("afm_node.disturbances.drift.**", Session(afm(DOTS, {"begin": SCAN}), is_started=False)),
    ("controller.lateral.lost_way_m", Session(PARTICLE, end_s=2.5)),
    ("controller.lateral.contact_n", Session(PARTICLE, end_s=2.5)),
    ("controller.passivity.force_margin_n", Session(both_ways({"delay_s": 0.05}))),
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
    ("afm_node.sample.period_m", Session(afm(DOTS, {"sample": {"name": "grating"}, "begin": SCAN}), is_started=False)),
    ("haptic_node.limits.max_force_n", Session({"haptic_node": {"driver": "simulated_impedance"}})),
)

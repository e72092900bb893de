"""Device nodes and what comes from a recording."""

from typing import Any

import pytest

from services.afm_node.node import AfmNode
from services.haptic_node.node import HapticNode
from telenano.afm.sim import simulated_afm
from telenano.hand.sim import SimulatedHaptic
from telenano.runtime.loop.node import Node
from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import HapticConfig

COMMANDS = {
    "afm_node@slave": ("afm/command", "controller@slave"),
    "haptic_node@master": ("haptic/command", "controller@master"),
}


def device(bench: Any, key: str, *, allow: bool) -> Node:
    if key.startswith("afm"):
        config = AfmConfig(allow_replay=allow)
        return AfmNode(bench.context, config, simulated_afm(config.to_params()))
    hand = HapticConfig(allow_replay=allow)
    simulated = SimulatedHaptic(hand.to_plant_params(), hand.device.start_position_m)
    return HapticNode(bench.context, hand, simulated)


def health(bench: Any, src: str) -> Any:
    zeros = dict.fromkeys(
        ("uptime_s", "rate_hz", "period_s", "lateness_p50_s", "lateness_p99_s", "lateness_max_s", "cpu_percent"), 0.0
    )
    counts = dict.fromkeys(("pid", "overruns", "memory_bytes"), 0)
    flags = {"realtime": False, "memory_locked": False, "replay": True}
    return bench.received("node/health", src, state="running", rejected={}, inputs=(), **zeros, **counts, **flags)


@pytest.mark.parametrize("allow", [False, True])
@pytest.mark.parametrize("key", list(COMMANDS))
def test_a_device_obeys_a_recording_only_where_that_is_allowed(bench_of: Any, key: str, allow: bool) -> None:
    bench = bench_of(key)
    node = device(bench, key, allow=allow)
    topic, src = COMMANDS[key]
    assert "node/health" in node.inputs
    fields = {"hand_seq": 0, "hand_t_ns": 0}
    zero = (0.0, 0.0, 0.0)
    if topic == "afm/command":
        fields |= {"mode": "hold", "base_position_m": zero}
    else:
        fields |= {"mode": "off", "position_m": zero, "velocity_m_per_s": zero, "force_n": zero}
    assert node.admits(bench.received(topic, src, **fields))
    assert node.admits(health(bench, src))
    assert node.admits(bench.received(topic, src, **fields)) is allow
    assert len([event for event in bench.take("session/event") if event.kind == "fault"]) == (not allow)
    node.make_safe()

"""Both halves as nodes over a link with delay: the law changes at run time and neither device jumps."""

from itertools import pairwise, permutations
from typing import Any

import pytest
from tried_laws import TRIED_LAWS as LAWS

from services.controller.master_half import MasterController
from services.controller.slave_half import SlaveController
from telenano.sections.controller_section import LAWS as INSTALLED
from telenano.sections.controller_section import ControllerConfig
from telenano.wire.errors import RefusedError
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

PERIOD_NS = 1_000_000
ZERO = (0.0, 0.0, 0.0)
SWITCHES = [pair for pair in permutations(LAWS, 2) if "virtual_impedance" in pair] + [
    ("wave", "passivity"),
    ("passivity", "model_mediated"),
    ("model_mediated", "wave"),
]


class Rig:
    """A hand that presses with 1 N on a spring of 20 N/m, each half at its site, `delay` ticks of link each way."""

    def __init__(self, bench_of: Any, law: str, delay: int, **config: Any) -> None:
        self.at_hand, self.at_tip = bench_of("controller@master"), bench_of("controller@slave")
        settings = ControllerConfig.model_validate({"law": law, **config})
        self.master = MasterController(self.at_hand.context, settings)
        self.slave = SlaveController(self.at_tip.context, settings)
        self.delay = delay
        self.flying: list[tuple[int, Any, Any]] = []
        self.n, self.x, self.base, self.following = 0, 0.0, 0.0, False
        self.rows: list[tuple[float, float, float, str]] = []
        self.statuses: list[Any] = []
        self.tip_status: list[Any] = []
        self.answers: list[Any] = []
        self.forwards = 0
        self.drift_m_per_s = 0.0
        for direction in ("forward", "backward"):
            self.master.on_message(self.at_hand.link_delay(direction, delay * PERIOD_NS))
        self.slave.on_message(self.at_tip.link_delay("forward", delay * PERIOD_NS))

    def send(self, node: Any, bench: Any, topic: str, message: Any, late: int) -> None:
        self.flying.append((self.n + late, (node, bench), (topic, message)))

    def set(self, node: Any, **parameters: Any) -> str:
        bench = self.at_hand if node is self.master else self.at_tip
        fields = {"id": "a", "command": "set", "target": "controller", "parameters": parameters}
        return str(node.on_control(bench.make("session/control", "console@master", **fields)))

    def deliver(self) -> None:
        due = [entry for entry in self.flying if entry[0] <= self.n]
        self.flying = [entry for entry in self.flying if entry[0] > self.n]
        for _, (node, bench), (topic, message) in due:
            node.on_message(Received(topic, message, b"", bench.clock.now_ns(), Arrival.NEXT))
            self.after()

    def after(self) -> None:
        for message in self.at_hand.take("teleop/forward"):
            self.forwards += 1
            self.send(self.slave, self.at_tip, "teleop/forward", message, self.delay)
        for message in self.at_tip.take("afm/command"):
            self.base = -message.base_position_m[2]
            answer = self.at_tip.received(
                "afm/state",
                "afm_node@slave",
                command_seq=message.seq,
                base_position_m=(0.0, 0.0, -self.base),
                deflection_m=0.0,
                tip_force_n=(0.0, 0.0, 20.0 * (self.base - self.drift_m_per_s * 1e-3 * self.n)),
                separation_m=0.0,
                separation_valid=False,
                in_contact=True,
                meniscus=False,
                mode="follow",
                limited=False,
                hand_seq=message.hand_seq,
                hand_t_ns=message.hand_t_ns,
                step_s=1e-3,
            )
            self.slave.on_message(answer)
        for message in self.at_tip.take("teleop/backward"):
            self.answers.append(message)
            self.send(self.master, self.at_hand, "teleop/backward", message, self.delay)
        for message in self.at_tip.take("law/status"):
            self.tip_status.append(message)
            self.send(self.master, self.at_hand, "law/status", message, self.delay)
        self.statuses += self.at_hand.take("law/status")
        for message in self.at_hand.take("haptic/command"):
            self.following = message.mode == "position"
            self.x = -message.position_m[2]
            self.rows.append((self.x, self.base, message.force_n[2], message.mode))
        if any(entry[0] <= self.n for entry in self.flying):
            self.deliver()

    def tick(self, count: int = 1, force_n: float = 1.0, wait_ns: int = PERIOD_NS) -> None:
        for _ in range(count):
            pause_ns = wait_ns // 2
            for bench in (self.at_tip, self.at_hand):
                bench.clock.advance_ns(pause_ns)
                bench.run_deferred()
            self.after()
            self.n += 1
            self.at_hand.clock.advance_ns(wait_ns - pause_ns)
            self.at_tip.clock.advance_ns(wait_ns - pause_ns)
            hand = self.at_hand.received(
                "haptic/state",
                "haptic_node@master",
                position_m=(0.0, 0.0, -self.x),
                velocity_m_per_s=ZERO,
                operator_force_n=(0.0, 0.0, -force_n),
                motor_force_n=ZERO,
                reference_m=ZERO,
                mode="position" if self.following else "off",
                estop=False,
                limited=False,
                session_s=-1.0,
                answered_seq=0,
                answered_t_ns=0,
                answered_at_ns=0,
                step_s=1e-3,
            )
            self.master.on_message(hand)
            self.after()
            self.deliver()


@pytest.mark.check("takes 1.1 s")
@pytest.mark.drawn(0.3, "telenano/laws/", "services/controller/")
@pytest.mark.parametrize(("first", "second"), SWITCHES)
def test_law_changes_without_a_jump_at_either_device(bench_of: Any, first: str, second: str) -> None:
    rig = Rig(bench_of, first, delay=8)
    rig.tick(1500)
    start = len(rig.rows)
    rig.set(rig.master, law=second)
    rig.tick(8)
    assert rig.master.half.switching
    rig.set(rig.slave, law=second)
    rig.tick(1500)
    assert not (rig.master.half.switching or rig.slave.half.switching)
    x, base, shown, modes = zip(*rig.rows, strict=True)
    assert set(modes[start:]) == {"position"}
    # at rest before: neither hand nor tip moves while the halves change, and then no faster than the force lets them
    frozen = slice(start - 1, start + 16)
    assert max(base[frozen]) - min(base[frozen]) < 1e-12
    assert max(x[frozen]) - min(x[frozen]) < 1e-6
    assert max(abs(b - a) for a, b in zip(base[start:], base[start + 1 :], strict=False)) < 1e-11
    assert len(set(shown[start : start + 8])) == 1
    # and the rest between the laws, whose forces at rest may differ by 5 %, is gone through without a step
    after = slice(start, start + 100)
    assert max(abs(at_m - x[start - 1]) for at_m in x[after]) <= 1e-4
    assert max(abs(force_n - shown[start - 1]) for force_n in shown[after]) <= 0.06
    assert max(1e8 * 20.0 * abs(at_m - base[start - 1]) for at_m in base[after]) <= 0.06
    assert 1e8 * 20.0 * base[-1] == pytest.approx(1.0, rel=0.06, abs=0.0)


def test_switch_in_motion_keeps_the_speed_and_comes_to_rest(bench_of: Any) -> None:
    rig = Rig(bench_of, "wave", delay=10)
    rig.tick(60)
    before = [row[0] for row in rig.rows[-3:]]
    speed = before[-1] - before[-2]
    assert speed > 1e-7
    rig.set(rig.master, law="passivity")
    rig.tick(40)
    steps = [b[0] - a[0] for a, b in zip(rig.rows[-41:], rig.rows[-40:], strict=False)]
    assert steps[0] == pytest.approx(speed, rel=0.25, abs=0.0)
    assert all(0.0 <= later < earlier for earlier, later in pairwise(steps))
    assert steps[-1] < 1e-3 * speed
    # the tip goes no further than what was on its way
    assert rig.base <= 1.5e-6 * rig.x


def test_half_that_waits_too_long_lets_the_hand_go(bench_of: Any) -> None:
    rig = Rig(bench_of, "virtual_impedance", delay=2, switch_limit_s=0.3)
    rig.tick(500)
    rig.set(rig.master, law="wave")
    rig.tick(290)
    assert rig.rows[-1][3] == "position"
    rig.tick(20)
    assert rig.rows[-1][3] == "off"
    # the slave learns late that the law has changed: the pair comes back by itself
    rig.set(rig.slave, law="wave")
    rig.tick(50)
    assert rig.rows[-1][3] == "position"


def test_slave_that_changes_first_stands_until_the_master_follows(bench_of: Any) -> None:
    rig = Rig(bench_of, "virtual_impedance", delay=2)
    rig.tick(800)
    rig.set(rig.slave, law="wave")
    base = rig.base
    rig.tick(100)
    assert rig.base == base
    assert rig.rows[-1][3] == "off"
    rig.set(rig.master, law="wave")
    rig.tick(1500)
    assert 1e8 * 20.0 * rig.base == pytest.approx(1.0, rel=0.02, abs=0.0)


def test_law_and_its_parameters_change_in_one_command(bench_of: Any) -> None:
    rig = Rig(bench_of, "virtual_impedance", delay=0)
    rig.tick(10)
    answer = rig.set(rig.master, **{"law": "wave", "wave.impedance_n_s_per_m": 50.0})
    assert "law = wave" in answer
    assert rig.master.params.impedance_n_s_per_m == 50.0


@pytest.mark.check("takes 1.0 s")
def test_status_reports_energy_passivity_and_round_trip(bench_of: Any) -> None:
    rig = Rig(bench_of, "wave", delay=30)
    rig.tick(2000)
    assert len(rig.statuses) == pytest.approx(200, abs=1)
    status, far = rig.statuses[-1], rig.tip_status[-1]
    assert (status.law, status.switching, status.heard, status.round_trip_valid) == ("wave", False, True, True)
    # the age of the newest answer at a sample of the hand: the round trip, and the tick since it came
    assert status.round_trip_s == pytest.approx(0.061, rel=1e-9, abs=0.0)
    assert status.net_valid
    assert status.passive
    # the spring holds F^2 / 2K at the hand's scale
    assert -far.port_energy_j == pytest.approx(0.5 / 3000.0, rel=1e-3, abs=0.0)
    assert status.net_energy_j == pytest.approx(status.port_energy_j + far.port_energy_j, rel=1e-6, abs=0.0)
    assert not far.net_valid
    assert not far.round_trip_valid
    assert far.left_j >= 0.0


@pytest.mark.check("takes 0.8 s")
@pytest.mark.parametrize("law", ["wave", "passivity"])
def test_counters_of_the_slave_go_on_when_a_sample_of_the_hand_was_late(bench_of: Any, law: str) -> None:
    rig = Rig(bench_of, law, delay=3)
    rig.tick(1500)
    # a sample of the hand that is late by 0.8 ms, and the next one in time
    rig.tick(1, wait_ns=1_800_000)
    rig.tick(1, wait_ns=200_000)
    rig.tick(500)
    energies = [answer.energy_j for answer in rig.answers]
    assert law == "passivity" or energies[1400] > 0.0
    assert all(before <= after for before, after in pairwise(energies))
    assert rig.rows[-1][3] == "position"
    assert 1e8 * 20.0 * rig.base == pytest.approx(1.0, rel=0.06, abs=0.0)
    assert rig.rows[-1][2] == pytest.approx(1.0, rel=0.06, abs=0.0)


@pytest.mark.check("takes 0.9 s")
def test_status_shows_that_a_delayed_reflection_makes_energy(bench_of: Any) -> None:
    rig = Rig(bench_of, "position_force", delay=60)
    rig.tick(1500)
    assert not all(status.passive for status in rig.statuses)
    quiet = Rig(bench_of, "position_force", delay=0)
    quiet.tick(1500)
    assert all(status.passive for status in quiet.statuses)


@pytest.mark.parametrize("law", ["virtual_impedance", "passivity"])
def test_dead_band_saves_messages_and_the_loop_lives(bench_of: Any, law: str) -> None:
    rig = Rig(bench_of, law, delay=5, deadband={"enabled": True})
    rig.tick(3000)
    assert rig.rows[-1][3] == "position"
    assert rig.forwards < 1200
    assert rig.statuses[-1].saved_percent > 60.0
    assert law == "virtual_impedance" or all(status.passive for status in rig.statuses)
    assert rig.statuses[-1].saved_percent == pytest.approx(100.0 * (1.0 - rig.forwards / 3000), rel=0.02, abs=0.0)
    assert 1e8 * 20.0 * rig.base == pytest.approx(1.0, rel=0.15, abs=0.0)


@pytest.mark.check("eight seconds of both halves as nodes")
@pytest.mark.parametrize(("drift_m_per_s", "ticks", "said"), [(-6e-11, 8000, "comes nearer"), (0.0, 3000, "")])
def test_a_sample_that_drifts_is_warned_of_once_with_the_error(
    bench_of: Any, drift_m_per_s: float, ticks: int, said: str
) -> None:
    rig = Rig(bench_of, "model_mediated", delay=8)
    rig.drift_m_per_s = drift_m_per_s
    rig.tick(ticks)
    found = [event for event in rig.at_hand.take("session/event") if "sample" in event.text]
    assert [event.level for event in found] == ["warning"] * bool(said)
    if said:
        assert f"the sample {said} by" in found[0].text
        told, error = found[0].data["drift_m_per_s"], found[0].data["error_m_per_s"]
        assert abs(told) - 2.0 * error > 1e-11
        assert abs(told - drift_m_per_s) <= 2.0 * error + 1.5e-11


@pytest.mark.grid(law="virtual_impedance")
@pytest.mark.parametrize("later", [1, 24])
@pytest.mark.parametrize("law", LAWS)
def test_the_delay_of_the_line_changes_in_a_held_contact_without_a_step(bench_of: Any, law: str, later: int) -> None:
    rig = Rig(bench_of, law, delay=8)
    rig.tick(1500)
    (hand_m, base_m, shown_n, _), start = rig.rows[-1], len(rig.rows)
    rig.delay = later
    # the line keeps the order: what is on its way comes with the first that is sent after the change
    rig.flying = [(min(due, rig.n + later), node, message) for due, node, message in rig.flying]
    rig.tick(200)
    rows = rig.rows[start:]
    # A line of waves is a spring b / (T + tau_f), which gets longer or shorter with T, as docs/laws.md states.
    most_m, most_n = (4e-4, 0.4) if law == "wave" else (1e-4, 0.05)
    assert max(abs(hand - hand_m) for hand, *_ in rows) <= most_m
    assert max(abs(shown - shown_n) for _, _, shown, _ in rows) <= most_n
    assert max(1e8 * 20.0 * abs(base - base_m) for _, base, *_ in rows) <= 0.05


@pytest.mark.check("holds a contact for seconds with both halves as nodes")
@pytest.mark.drawn(0.4, "telenano/laws/", "services/controller/")
@pytest.mark.parametrize(
    ("law", "key", "factor"),
    [
        ("wave", "filter_s", 0.3),
        ("wave", "filter_s", 2.0),
        ("wave", "damping_n_s_per_m", 2.0),
        ("passivity", "coupling_stiffness_n_per_m", 0.5),
        ("passivity", "coupling_stiffness_n_per_m", 2.0),
        ("passivity", "energy_cap_j", 0.1),
        ("model_mediated", "guard_damping_n_s_per_m", 2.0),
        ("virtual_impedance", "force_gain", 0.8),
    ],
)
def test_a_setting_changes_in_a_held_contact_without_a_step_at_either_half(
    bench_of: Any, law: str, key: str, factor: float
) -> None:
    rig = Rig(bench_of, law, delay=8)
    rig.tick(2500)
    (hand_m, base_m, shown_n, _), start = rig.rows[-1], len(rig.rows)
    value = factor * getattr(rig.master.config.law_config(), key)
    rig.set(rig.master, **{f"{law}.{key}": value})
    rig.tick(3)
    rig.set(rig.slave, **{f"{law}.{key}": value})
    rig.tick(500)
    rows = rig.rows[start:]
    assert {mode for *_, mode in rows} == {"position"}
    assert max(abs(hand - hand_m) for hand, *_ in rows) <= 1e-4
    assert max(abs(shown - shown_n) for _, _, shown, _ in rows) <= 0.05
    assert max(1e8 * 20.0 * abs(base - base_m) for _, base, *_ in rows) <= 0.05
    assert [status.passive for status in (*rig.statuses, *rig.tip_status) if status.passive is False] == []


@pytest.mark.parametrize(
    ("law", "key"),
    [
        *((law, scale) for law in INSTALLED for scale in ("position_scale", "force_scale")),
        ("wave", "impedance_n_s_per_m"),
        ("model_mediated", "cantilever_stiffness_n_per_m"),
    ],
)
def test_a_scale_waits_until_the_tip_is_off_the_sample_and_both_halves_say_why(
    bench_of: Any, law: str, key: str
) -> None:
    rig = Rig(bench_of, law, delay=2)
    rig.tick(300)
    value = 1.25 * getattr(rig.master.config.law_config(), key)
    for half in (rig.master, rig.slave):
        before = half.params
        with pytest.raises(RefusedError, match=f"{law}.{key} cannot be changed while the tip touches"):
            rig.set(half, **{f"{law}.{key}": value})
        assert half.params == before
    rig.master.half.signal = rig.master.half.signal._replace(in_contact=False)
    rig.slave.memory.tip = rig.slave.memory.tip._replace(in_contact=False)
    for half in (rig.master, rig.slave):
        assert f"{law}.{key}" in rig.set(half, **{f"{law}.{key}": value})

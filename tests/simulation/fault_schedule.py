"""A schedule of faults as data, drawn from one seed.

    schedule = Schedule.drawn(7)
    Schedule.of(json.loads(schedule.text())) == schedule

Each event is a mapping with `at_s`, the time since the processes were started [s], `kind`, and the keys of that kind:

| kind | keys |
|---|---|
| delay | forward_s, backward_s: delays of the network from now on |
| line | direction, loss, duplicate, reorder, corrupt, jitter_s, for_s |
| partition | direction (both, forward, backward), for_s |
| narrow | direction, bytes_per_s, for_s |
| clock | ahead_s, drift_ppm of the slave's site, from its first start on |
| site_restart | ahead_s: the slave's processes are ended and started with a clock that was set meanwhile |
| disk | site, fault (full, slow, gone), for_s |
| kill | node; how its process ends: killed, in order (ended), by an error in a turn (failed), or in order while \
another one begins (replaced); after: number of messages that a killed one still sends; torn: share of the data not \
flushed that reaches the disk |
| stall | node, for_s |
| device | device (hand, tip), fault (lost, late, repeating, range; of the tip also risen, a sample that rises), for_s |
| press | site, target: an emergency stop |
| arm | target (hand, tip, both), place: whether the tip is told to go to the hand |
| start, stop | of the force profile |
| law | law |
| link | delay_s, loss: settings of the link |

The end is always the same: after the last event a person arms both devices, and starts the force profile again if it
was stopped, so that a rig that can go on must do so.
"""

import json
import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

Event = dict[str, Any]
HAND, TIP, LINK = "haptic_node@master", "afm_node@slave", "delay_node@master"
HALVES = ("controller@master", "controller@slave")
PAGE = "view@master"
RECORDERS = ("recorder@master", "recorder@slave")
NODES = (HAND, TIP, LINK, *HALVES, *RECORDERS)
# Half of the draws take one of the first two laws.
LAWS = (
    "wave", "virtual_impedance", "position_force", "passivity", "bounded_model", "four_channel", "fractal_impedance",
    "matched_wave", "model_mediated", "smith", "tactile", "tdpa", "two_layer",
)  # fmt: skip
# Rates of the loops [Hz]: at 50 Hz the deadline of the devices has two and a half periods, at 250 Hz twelve.
RATES_HZ = (50.0, 100.0, 100.0, 250.0)
# A law that promises nothing, and presses beyond the limit of the instrument at less than the greatest of these rates,
# without any fault.
FAST_LAW = "four_channel"
# Processes of the loop: one for each node, or one for the nodes of a site.
PROCESSES = ("node", "site")
# Limits of the force on the tip [N]: that of the defaults, and one that a session with its overshoots keeps, but not a
# sample that rises under the tip.
FORCE_LIMITS_N = (200e-9, 60e-9)
# Latest begin of a group of faults, since the start of the processes [s].
FAULTS_S = 4.5
# Share of the schedules in which only the delay changes, under the first law. Hand and tip then stay coupled for all of
# the session, as the energy at both ports is judged: a law that makes some, at each period, needs seconds to show it.
CALM_SHARE = 0.1
# Time without faults after the last one, before a person arms; and time after that in which the rig must recover.
CALM_S = 0.7
RECOVERY_S = 2.0
SESSION_S = 8.5
# Who pushes the hand: a profile of force, or a person at the page; an eighth of the sessions have that one.
OPERATORS = ("profile", "page")
PAGE_SHARE = 0.125
# Share of the sessions that end in order among the faults, so that what is away or late then is accounted for as well.
ABRUPT_SHARE = 0.125


class Schedule(NamedTuple):
    """A session with its faults.

    seed: seed of all delays on the sites; law: the law at the start; delay_s: delay of the network in each direction
    [s]; link_s: delay that the link adds in each direction [s]; events: the events in the order of time; rate_hz: the
    rate of the loops [Hz]; force_limit_n: force on the tip above which its guard withdraws it [N]; processes: those of
    the loop, one of `PROCESSES`; session_s: time from the start of the force profile to the end of the session [s];
    operator: who pushes the hand, one of `OPERATORS`.
    """

    seed: int
    law: str
    delay_s: float
    link_s: float
    events: tuple[Event, ...]
    rate_hz: float = 250.0
    force_limit_n: float = 200e-9
    processes: str = "node"
    session_s: float = SESSION_S
    operator: str = "profile"

    @classmethod
    def drawn(cls, seed: int, processes: str | None = None) -> "Schedule":
        """Return the random schedule of a seed, with these processes of the loop if they are given."""
        dice = random.Random(f"schedule {seed}")
        events: list[Event] = []
        if dice.random() < 0.4:
            ahead_s = round(dice.choice([0.003, 0.2, 7.0, 3600.0]) * dice.choice([1, -1]), 4)
            events.append({"at_s": 0.0, "kind": "clock", "ahead_s": ahead_s, "drift_ppm": dice.choice([0, 20, -40])})
        is_calm = dice.random() < CALM_SHARE
        for _ in range(dice.choice([1, 2, 2, 3, 3, 4, 5, 6])):
            group = dice.choices(list(_GROUPS), [weight for weight, _ in _GROUPS.values()])[0]
            draw = _short_delay if is_calm else _GROUPS[group][1]
            events += draw(dice, round(dice.uniform(0.3, FAULTS_S), 3))
        events = _few_kills(events)
        delay_s, link_s = dice.choice([0.001, 0.005, 0.02, 0.05]), dice.choice([0.0, 0.0, 0.01])
        events.sort(key=lambda one: one["at_s"])
        law, rate_hz = "wave" if is_calm else _law(dice), dice.choice(RATES_HZ)
        laws = {law, *(one["law"] for one in events if one["kind"] == "law")}
        if FAST_LAW in laws:
            rate_hz = max(RATES_HZ)
        if laws != {"wave"}:
            # Over a long way only wave variables promise to go on, so that nothing could be judged at the end.
            ends_s = round(max(one["at_s"] + one.get("for_s", 0.0) for one in events), 4)
            events.append({"at_s": ends_s, "kind": "delay", "forward_s": 0.01, "backward_s": 0.01})
        has_risen = any(one.get("fault") == "risen" for one in events)
        limit_n = min(FORCE_LIMITS_N) if has_risen else dice.choice(FORCE_LIMITS_N)
        drawn, session_s = dice.choice(PROCESSES), _session_s(dice)
        schedule = cls(seed, law, delay_s, link_s, tuple(events), rate_hz, limit_n, processes or drawn, session_s)
        if is_calm or dice.random() >= PAGE_SHARE:
            return schedule
        events.extend(_page(dice))
        return schedule._replace(operator="page", events=tuple(sorted(events, key=lambda one: one["at_s"])))

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> "Schedule":
        """Return a schedule from its document; raise ValueError if that is invalid."""
        if missing := set(cls._fields) - set(cls._field_defaults) - set(document):
            raise ValueError(f"the schedule has no {', '.join(sorted(missing))}")
        events = tuple(document["events"])
        for event in events:
            if event.get("kind") not in KINDS or "at_s" not in event:
                raise ValueError(f"{event}: an event has `at_s` and a `kind` of {', '.join(sorted(KINDS))}")
        return cls(**{name: value for name, value in document.items() if name in cls._fields} | {"events": events})

    def text(self) -> str:
        """Return the schedule as JSON."""
        return json.dumps({**self._asdict(), "events": list(self.events)}, indent=1)

    def with_events(self, events: Sequence[Event]) -> "Schedule":
        """Return the same session with other faults."""
        return self._replace(events=tuple(events))

    @property
    def calm_s(self) -> float:
        """Time at which a person arms: `CALM_S` after the end of the last fault [s]."""
        ends = (one["at_s"] + one.get("for_s", 0.0) for one in self.events)
        return max([*ends, 1.0]) + CALM_S


def _session_s(dice: random.Random) -> float:
    """Draw the length of a session [s]: an eighth of them end among the faults."""
    return round(dice.uniform(1.0, 5.0), 2) if dice.random() < ABRUPT_SHARE else SESSION_S


def _law(dice: random.Random) -> str:
    return dice.choice(dice.choice([LAWS[:2], LAWS]))


def _network(dice: random.Random, at_s: float) -> list[Event]:
    kind = dice.choice(["delay", "delay", "line", "partition", "partition", "narrow"])
    way = dice.choice(["both", "forward", "backward"])
    for_s = dice.choice([0.04, 0.12, 0.3, 0.8, 1.5])
    if kind == "delay":
        return _delay(dice, at_s, (0.001, 0.01, 0.03, 0.06, 0.1))
    if kind == "line":
        bad = dice.sample(["loss", "duplicate", "reorder", "corrupt"], dice.choice([1, 1, 2]))
        line = {name: dice.choice([0.02, 0.1, 0.3]) if name in bad else 0.0 for name in _LINE}
        jitter_s = 0.01 if line["reorder"] else dice.choice([0.0, 0.003])
        return [{"at_s": at_s, "kind": kind, "direction": way, **line, "jitter_s": jitter_s, "for_s": for_s}]
    if kind == "narrow":
        rate = dice.choice([20e3, 60e3, 150e3])
        return [{"at_s": at_s, "kind": kind, "direction": way, "bytes_per_s": rate, "for_s": for_s}]
    return [{"at_s": at_s, "kind": kind, "direction": way, "for_s": for_s}]


def _delay(dice: random.Random, at_s: float, delays_s: Sequence[float]) -> list[Event]:
    there_s, back_s = (dice.choice(delays_s) for _ in range(2))
    return [{"at_s": at_s, "kind": "delay", "forward_s": there_s, "backward_s": dice.choice([there_s, back_s])}]


def _short_delay(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a change of the delay by less than a deadline, which no device takes for a loss."""
    return _delay(dice, at_s, (0.001, 0.01, 0.03))


def _process(dice: random.Random, at_s: float) -> list[Event]:
    node = dice.choice(NODES)
    if dice.random() < 0.5:
        return [{"at_s": at_s, "kind": "stall", "node": node, "for_s": dice.choice([0.03, 0.08, 0.2, 0.6, 1.5])}]
    after = dice.choice([0, 0, 1, 2, 3])
    kill = {"at_s": at_s, "kind": "kill", "node": node, "after": after, "torn": dice.choice([0.0, 0.5, 1.0])}
    # A process may also end in order, or by an error in a turn, and announces that.
    return [kill | {"how": dice.choice(["killed", "killed", "ended", "failed", "replaced"])}]


def _disk(dice: random.Random, at_s: float) -> list[Event]:
    fault = dice.choice(["full", "slow", "gone"])
    site, for_s = dice.choice(["master", "slave"]), dice.choice([0.1, 0.5, 1.5])
    return [{"at_s": at_s, "kind": "disk", "site": site, "fault": fault, "for_s": for_s}]


def _device(dice: random.Random, at_s: float) -> list[Event]:
    device, fault = dice.choice(["hand", "tip"]), dice.choice(["lost", "late", "repeating", "range", "risen"])
    device = "tip" if fault == "risen" else device
    return [{"at_s": at_s, "kind": "device", "device": device, "fault": fault, "for_s": dice.choice([0.05, 0.2, 0.7])}]


def _people(dice: random.Random, at_s: float) -> list[Event]:
    kind = dice.choice(["press", "press", "press", "arm", "arm", "start", "stop", "law", "law", "link", "two"])
    if kind == "press":
        events = [_press(dice, at_s)]
        if dice.random() < 0.6:
            events.append(_arm(dice, round(at_s + dice.choice([-0.05, 0.0, 0.1, 0.7]), 3)))
        return events
    if kind == "arm":
        return [_arm(dice, at_s)]
    if kind == "law":
        return [{"at_s": at_s, "kind": kind, "law": _law(dice)}]
    if kind == "link":
        delay_s, loss = dice.choice([0.0, 0.01, 0.03]), dice.choice([0.0, 0.0, 0.05])
        return [{"at_s": at_s, "kind": kind, "delay_s": delay_s, "loss": loss}]
    if kind == "two":
        return [_arm(dice, at_s), dice.choice([_press, _arm])(dice, at_s)]
    return [{"at_s": at_s, "kind": kind}]


def _page(dice: random.Random) -> list[Event]:
    """Draw moments in which a page sends nothing while its person pushes: it hangs, or its connection is lost."""
    return [
        {"at_s": round(dice.uniform(1.0, FAULTS_S), 3), "kind": "stall", "node": PAGE, "for_s": for_s}
        for for_s in dice.sample([0.08, 0.2, 0.6, 1.5], dice.choice([1, 2]))
    ]


def _meeting(dice: random.Random, at_s: float) -> list[Event]:
    """Draw two faults of different groups that begin within 0.1 s, which is rare in single draws."""
    draws = [_network, _process, _people, _disk, _device]
    return [event for draw in dice.sample(draws, 2) for event in draw(dice, round(at_s + dice.uniform(0.0, 0.1), 3))]


def _restart(dice: random.Random, at_s: float) -> list[Event]:
    return [{"at_s": at_s, "kind": "site_restart", "ahead_s": dice.choice([0.0, 0.5, -30.0, 3600.0])}]


def _stopped_again(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a stop at the instrument, an arming of the withdrawn tip, and, in half, a stop while that is in transit."""
    at_s = min(at_s, 2.5)
    arm_s = round(at_s + dice.choice([0.8, 1.6]), 3)
    press = {"kind": "press", "site": "slave", "target": "afm_node"}
    arm = {"at_s": arm_s, "kind": "arm", "target": dice.choice(["tip", "both"]), "place": False}
    later_s = round(arm_s + dice.choice([0.0005, 0.002, 0.005, 0.02, 0.05]), 4)
    return [{"at_s": at_s, **press}, arm, *([{"at_s": later_s, **press}] if dice.random() < 0.5 else [])]


def _ended_in_a_stop(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a stop of a device, and then its loss or the end of its process; no person has armed it meanwhile."""
    node, site = dice.choice([(HAND, "master"), (TIP, "master"), (TIP, "slave")])
    press = {"kind": "press", "site": site, "target": node.partition("@")[0]}
    later_s = round(at_s + dice.choice([0.2, 0.5]), 3)
    if dice.random() < 0.5:
        device = "hand" if node == HAND else "tip"
        end = {"kind": "device", "device": device, "fault": "lost", "for_s": dice.choice([0.05, 0.2, 0.7])}
    else:
        how = dice.choice(["killed", "ended", "failed", "replaced"])
        end = {"kind": "kill", "node": node, "after": 0, "torn": 0.0, "how": how}
    return [{"at_s": at_s, **press}, {"at_s": later_s, **end}]


def _unanswered(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a network that carries the hand's samples, and no answers for longer than a hand may do without them."""
    return [{"at_s": at_s, "kind": "partition", "direction": "backward", "for_s": dice.choice([0.8, 1.5])}]


def _stop_while_away(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a stop for a device while it is started again or stands still, or the link or the network is away."""
    away = dice.choice(["hand", "tip", "link", "still", "cut"])
    for_s = dice.choice([0.12, 0.3, 0.8])
    if away == "still":
        fault: Event = {"at_s": at_s, "kind": "stall", "node": TIP, "for_s": for_s}
    elif away == "cut":
        way = dice.choice(["both", "forward", "backward"])
        fault = {"at_s": at_s, "kind": "partition", "direction": way, "for_s": for_s}
    else:
        node = {"hand": HAND, "tip": TIP, "link": LINK}[away]
        fault = {"at_s": at_s, "kind": "kill", "node": node, "after": 0, "torn": dice.choice([0.0, 0.5, 1.0])}
    later_s = round(at_s + dice.uniform(0.0, min(for_s, 0.12)), 4)
    if away == "hand":
        press = {"site": "master", "target": dice.choice(["*", "haptic_node"])}
    else:
        press = {"site": dice.choice(["master", "slave"]), "target": "afm_node"}
    return [fault, {"at_s": later_s, "kind": "press", **press}]


def _answer_lost(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a stop from the master's site, and the end of the link while the stop or, more often, its answer crosses.

    The answer needs a long way back, and the whole way is short enough for any law to go on.
    """
    there_s, back_s = dice.choice([0.001, 0.01]), dice.choice([0.03, 0.045])
    delay = {"kind": "delay", "forward_s": there_s, "backward_s": back_s}
    press = {"kind": "press", "site": "master", "target": dice.choice(["*", "afm_node"])}
    later_s = round(at_s + there_s + dice.uniform(-0.01, back_s), 4)
    kill = {"kind": "kill", "node": LINK, "after": 0, "torn": 0.0}
    return [{"at_s": round(max(at_s - 0.1, 0.0), 3), **delay}, {"at_s": at_s, **press}, {"at_s": later_s, **kill}]


def _law_while_cut(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a change to another law and back while the network is away: one of the two is a change."""
    at_s = min(at_s, 3.0)
    way, for_s = dice.choice(["both", "forward", "backward"]), dice.choice([0.12, 0.3, 0.8])
    begins_s = round(at_s + dice.uniform(-0.05, 0.05), 4)
    first, then = dice.sample(LAWS, 2)
    laws: list[Event] = [
        {"at_s": at_s, "kind": "law", "law": first},
        {"at_s": round(at_s + for_s + 1.0, 3), "kind": "law", "law": then},
    ]
    return [{"at_s": begins_s, "kind": "partition", "direction": way, "for_s": for_s}, *laws]


def _half_of_another_law(dice: random.Random, at_s: float) -> list[Event]:
    """Draw a change of the law, and then the end of one half, whose new process has the law of the scenario.

    Whether the rig goes on is judged for any law only where the way is short.
    """
    short = _short_delay(dice, max(round(at_s - 0.1, 3), 0.0))
    kill = {"kind": "kill", "node": dice.choice(HALVES), "after": 0, "torn": 0.0}
    later_s = round(at_s + dice.uniform(0.2, 0.8), 3)
    return [*short, {"at_s": at_s, "kind": "law", "law": dice.choice(LAWS)}, {"at_s": later_s, **kill}]


def _longer_way(dice: random.Random, _: float) -> list[Event]:
    """Draw a longer way while the hand goes to the sample: what comes is too old, and would lead a held base on."""
    there = {"forward_s": dice.choice([0.1, 0.12]), "backward_s": 0.01}
    return [{"at_s": round(dice.uniform(0.9, 1.25), 3), "kind": "delay", **there}]


def _risen(dice: random.Random, _: float) -> list[Event]:
    """Draw a sample that rises under a tip on which the hand presses."""
    risen = {"kind": "device", "device": "tip", "fault": "risen", "for_s": 0.7}
    return [{"at_s": round(dice.uniform(1.6, 3.0), 3), **risen}]


def _press(dice: random.Random, at_s: float) -> Event:
    site = dice.choice(["master", "master", "slave"])
    target = "afm_node" if site == "slave" else dice.choice(["*", "*", "haptic_node", "afm_node"])
    return {"at_s": at_s, "kind": "press", "site": site, "target": target}


def _arm(dice: random.Random, at_s: float) -> Event:
    return {"at_s": max(at_s, 0.1), "kind": "arm", "target": dice.choice(["hand", "tip", "both"]), "place": False}


def _few_kills(events: Sequence[Event]) -> list[Event]:
    """Limit kills and site restarts to three: after more, the launcher rightly gives up the rig."""
    kept, kills = [], 0
    for event in events:
        kills += event["kind"] in ("kill", "site_restart")
        if event["kind"] not in ("kill", "site_restart") or kills <= 3:
            kept.append(event)
    return kept


_LINE = ("loss", "duplicate", "reorder", "corrupt")
_GROUPS: dict[str, tuple[float, Callable[[random.Random, float], list[Event]]]] = {
    "network": (3.0, _network),
    "process": (3.0, _process),
    "people": (3.0, _people),
    "meeting": (3.0, _meeting),
    "disk": (1.0, _disk),
    "device": (1.0, _device),
    "restart": (0.4, _restart),
    "stopped again": (1.0, _stopped_again),
    "stop while away": (1.0, _stop_while_away),
    "ended in a stop": (1.2, _ended_in_a_stop),
    "unanswered": (0.8, _unanswered),
    "longer way": (1.0, _longer_way),
    "law while cut": (0.4, _law_while_cut),
    "answer lost": (0.4, _answer_lost),
    "half of another law": (0.8, _half_of_another_law),
    "risen": (1.0, _risen),
}
KINDS = frozenset(
    {
        "delay", "line", "partition", "narrow", "clock", "site_restart", "disk", "kill", "stall", "device", "press",
        "arm", "start", "stop", "law", "link",
    }
)  # fmt: skip

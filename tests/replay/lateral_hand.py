"""A simulated hand that presses the tip beside a particle and pushes it across the sample, on the virtual rig."""

import math
from typing import Any, NamedTuple

import yaml

from telenano.settings import find_scenario
from telenano.virtual import ARMED_S, STARTED_S, Timing, VirtualBus, VirtualRig

# The tip begins at 0, 0, a little more than d behind.
PARTICLE_M = (3.5e-7, 0.0)
FIXTURES = (
    "controller.lateral.guide.enabled=true",
    "controller.lateral.disc.enabled=true",
    "controller.lateral.disc.y_m=-1.2e-6",
    "controller.lateral.depth.enabled=true",
)
TIMING = Timing((0, 1), (1_000, 1_001), None, (10_000, 10_001), (1_000, 1_001), (1_000, 1_001), stall_share=0.0)


# the spring of a page, how often it speaks, and how old the place is that it knows
PAGE_N_PER_M, PAGE_SAYS_S, PAGE_LAG_S = 200.0, 0.033, 0.06


class Pushed(NamedTuple):
    """What came of it.

    particle_m: where the particle really is; tip_m: where the stage is; felt_n: greatest lateral force at the hand;
    mode: of the instrument; across_j: least energy that has entered across; is_passive: whether both halves said so at
    all times; news: what the hand was told; rig: for more.
    """

    particle_m: tuple[float, float]
    tip_m: tuple[float, float]
    felt_n: float
    mode: str
    least_j: float
    is_passive: bool
    news: list[str]
    rig: VirtualRig


def scenario(presses_s: float, push_s: float, press_n: float) -> dict[str, Any]:
    """Return the scenario `assembly` with one particle, and a hand that presses, and then pushes for so long [s]."""
    document: dict[str, Any] = yaml.safe_load(find_scenario("assembly").read_text("utf-8"))
    path = [(0.0, 0.0), (presses_s, 0.0), (presses_s + 0.1, 12.0), (presses_s + push_s, 12.0)]
    presses = [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.1, "force_n": press_n}]
    document["haptic_node"] = {
        "operator": {"kind": "force_profile", "points": presses},
        "lateral": {"path": [{"time_s": t, "x_m": 1e-3 * x} for t, x in path]},
    }
    document["afm_node"]["sample"]["particles"] = {"places": [list(PARTICLE_M)]}
    document["duration_s"] = presses_s + push_s
    return document


def push_by_hand(
    settings: tuple[str, ...] = (), presses_s: float = 1.5, push_s: float = 2.0, press_n: float = 1.0
) -> Pushed:
    """Run the session, and return what came of it."""
    document = scenario(presses_s, push_s, press_n)
    rig = VirtualRig(None, 1, settings, TIMING, document)
    # The halves have to hear each other first.
    begins_s = ARMED_S if not settings else 0.6
    rig.run_until(begins_s)
    rig.command("arm", "*", place="hand")
    begins_s += STARTED_S - ARMED_S
    rig.run_until(begins_s)
    rig.command("start", "haptic_node")
    rig.run_until(begins_s + document["duration_s"])
    rig.close()
    return pushed(rig)


def pushed(rig: VirtualRig) -> Pushed:
    """Return what has come of a session so far."""
    part = rig.loops["afm_node@slave"].node._driver.state.part  # type: ignore[attr-defined]
    state = rig.received("afm/state", "afm_node@slave")[-1]
    forces = [math.hypot(*message.force_n[:2]) for message in rig.received("haptic/command", "controller@master")]
    statuses = rig.received("law/status", "controller@master")
    events = rig.received("session/event", "controller@master")
    x_m, y_m = part.moving[0, :2].tolist()
    return Pushed(
        (x_m, y_m),
        state.base_position_m[:2],
        max(forces),
        state.mode,
        min(status.net_energy_j for status in statuses),
        all(status.passive for status in statuses),
        [str(event.data["lateral"]) for event in events if "lateral" in event.data],
        rig,
    )


class LatePage:
    """A page whose person presses with 1 N, and may hold the stylus across: what it knows of that is late.

    Args:
        settings: Dotted flags on top of the scenario `assembly` with one particle beside the tip.
        begins_s: When the halves have heard each other, and its person begins to press [s].
    """

    def __init__(self, settings: tuple[str, ...], begins_s: float) -> None:
        document = scenario(0.0, 1.0, 1.0)
        document["haptic_node"] = {"operator": {"kind": "interactive"}, "lateral": {}}
        self.rig = VirtualRig(None, 1, settings, TIMING, document)
        self._bus, self._now_s = VirtualBus(self.rig, "viz_node@master"), begins_s
        self.rig.run_until(begins_s)
        self.rig.command("arm", "*", place="hand")
        self.rig.command("start", "haptic_node")

    def hold(self, duration_s: float, across_m: float | None) -> None:
        """Press for a time [s], and mean to be so far across [m]; none: the pointer there is let go."""
        end_s = self._now_s + duration_s
        while self._now_s < end_s:
            places = self.rig.received("haptic/state", "haptic_node@master")
            known_m = places[-min(len(places), round(PAGE_LAG_S / 1e-3))].position_m[0]
            across_n = 0.0 if across_m is None else PAGE_N_PER_M * (across_m - known_m)
            self._bus.publish("operator/force", force_n=(across_n, 0.0, -1.0))
            self.wait(PAGE_SAYS_S)

    def wait(self, duration_s: float) -> None:
        """Say nothing for a time [s], as a page that was killed."""
        self._now_s += duration_s
        self.rig.run_until(self._now_s)

    def stage_m(self) -> list[float]:
        """Return where the stage was across at each step of the instrument [m]."""
        return [state.base_position_m[0] for state in self.rig.received("afm/state", "afm_node@slave")]

    def close(self) -> None:
        self._bus.close()
        self.rig.close()

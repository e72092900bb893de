"""No answer, no following, and no stop that is lost: two sites with ways and transports that are blocked."""

import shutil
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from blocked_ways import FAULTS_OF, RELAY_KILLED, WAYS, coupled_again, fault, injected, sites_of, started
from ledger import record
from two_sites import TwoSites, needs_namespaces

needs_router = pytest.mark.skipif(shutil.which("nft") is None, reason="the command `nft` (nftables) is not installed")
pytestmark = [
    needs_namespaces,
    needs_router,
    pytest.mark.stack,
    pytest.mark.check("a rig of two sites"),
    pytest.mark.timeout(580),
]

NS_PER_S = 1_000_000_000
# since the last answer that reached the hand [s]
TIP_S, HAND_S = 0.5, 0.1
OVER = {"cable": "over a cable", "direct": "past a relay", "relayed": "through a relay"}


@pytest.fixture(params=WAYS)
def rig(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[tuple[str, TwoSites]]:
    found = sites_of(request.param, tmp_path)
    try:
        started(found, request.param)
        yield request.param, found
    finally:
        found.close()


@pytest.mark.endurance
def test_hand_and_tip_stop_soon_after_the_last_answer(rig: tuple[str, TwoSites]) -> None:
    way, sites = rig
    found = {name: injected(sites, name) for name in FAULTS_OF[way]}
    tip_s, hand_s = (
        max(getattr(what, key) for what in found.values()) for key in ("tip_unanswered_s", "hand_unanswered_s")
    )
    record(
        f"each way and each transport between the sites blocked, alone and together, {OVER[way]}",
        f"followed {1e3 * tip_s:.0f} ms, driven {1e3 * hand_s:.0f} ms beyond it at most, of {len(found)} faults",
    )
    if way == "direct":
        killed = found[RELAY_KILLED]
        assert killed.tip_s is not None
        assert killed.hand_s is not None
        record(
            "the relay is killed while the datagrams go past it",
            f"tip held after {killed.tip_s:.1f} s, hand off after {killed.hand_s:.1f} s, after other outages",
        )
    assert {name: what for name, what in found.items() if what.tip_unanswered_s > TIP_S + what.late_s} == {}
    assert {name: what for name, what in found.items() if what.hand_unanswered_s > HAND_S + what.late_s} == {}
    # Without answers the tip does not go on, whatever else crosses.
    assert all(found[name].tip_s is not None for name in FAULTS_OF[way] if name.startswith("all"))


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("all_both", "nothing crosses between the sites"),
        pytest.param("tcp_both", "no TCP crosses between the sites", marks=pytest.mark.endurance),
    ],
)
@pytest.mark.parametrize("rig", ["cable"], indirect=True)
def test_a_stop_that_cannot_cross_is_obeyed_before_anything_follows(
    rig: tuple[str, TwoSites], name: str, what: str
) -> None:
    _, sites = rig
    coupled_again(sites)
    with fault(sites, name):
        # The console ends without an answer, and the link keeps the stop.
        stopped = sites.master.telenano("session", "estop", "--site", "master", "--target", "afm_node")
        assert stopped.returncode != 0
    begin_ns = min(control.t_ns for control in stops(sites))
    sites.wait_until(lambda: modes(sites, time.time_ns() - NS_PER_S) == {"estop"}, "an instrument in emergency stop")
    since: list[Any] = [message.decode() for message in sites.slave.recording().messages("afm/state", begin_ns)]
    followed = [state.t_ns for state in since if state.t_ns > begin_ns and state.mode == "follow"]
    # It went on for no longer than a sample counts, by the samples that had crossed before.
    gaps_ns = [now.t_ns - old.t_ns for old, now in pairwise(since)]
    assert max(followed, default=begin_ns) - begin_ns <= HAND_S * NS_PER_S + max(gaps_ns)
    armed = sites.master.telenano("session", "arm", "--site", "master", "--target", "afm_node")
    assert armed.returncode == 0, armed.stderr
    coupled_again(sites)
    record(
        f"an emergency stop for the tip while {what}",
        f"followed {(max(followed, default=begin_ns) - begin_ns) / 1e6:.0f} ms more; in emergency stop once it crossed,"
        " and released by an `arm` that quotes it",
    )


def stops(sites: TwoSites) -> list[Any]:
    """Give the stops that the master's site has sent."""
    found: list[Any] = [message.decode() for message in sites.master.recording().messages("session/control")]
    return [control for control in found if control.command == "estop"]


def modes(sites: TwoSites, since_ns: int) -> set[str]:
    return {message.fields()["mode"] for message in sites.slave.recording().messages("afm/state", since_ns)}

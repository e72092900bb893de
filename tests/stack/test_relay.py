"""Both sites behind routers that let nobody in, and a relay that both dial: the session, and what befalls the relay."""

import json
import re
import shutil
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from ledger import record
from relayed_sites import PORT, RelayedSites
from stack_rig import judged
from two_sites import Site, needs_namespaces, sniff

needs_router = pytest.mark.skipif(shutil.which("nft") is None, reason="the command `nft` (nftables) is not installed")
pytestmark = [needs_namespaces, needs_router, pytest.mark.stack, pytest.mark.timeout(300)]

ENDS = {"master": "delay_node@master", "slave": "controller@slave"}
IN_THE_CLEAR = (b"teleop/forward", b"virtual_impedance", b"position_m", b"afm/state", b"session/control")
NS_PER_S = 1_000_000_000
HOSTILE = Path(__file__).parent / "hostile_relay.py"


@pytest.fixture
def rig(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[RelayedSites]:
    strict = getattr(request, "param", False)
    found = RelayedSites(tmp_path, strict=strict)
    found.master.lean = found.slave.lean = True
    yield found
    found.close()


def both(rig: RelayedSites, text: str, times: int = 1) -> bool:
    """Give whether both ends have said a text so many times."""
    return all(site.has_log(ENDS[site.name], text, times) for site in rig.sites)


def outside_listeners(site: Site) -> list[str]:
    """Give the addresses, as the kernel writes them, at which TCP connections from other machines could be accepted."""
    text = "print(open('/proc/net/tcp').read() + open('/proc/net/tcp6').read())"
    rows = [line.split() for line in site.python(text).communicate(timeout=60)[0].splitlines()]
    listening = [row[1] for row in rows if len(row) > 3 and row[3] == "0A"]
    assert listening
    # the last byte of the address comes first
    return [found for found in listening if not re.fullmatch("[0-9A-F]{6}7F:[0-9A-F]{4}", found)]


def mode(rig: RelayedSites) -> str:
    """Give the mode of the tip."""
    return str(rig.slave.recording().messages("afm/state", time.time_ns() - 2 * NS_PER_S)[-1].fields()["mode"])


def newest_report(site: Site) -> Any:
    reports = reversed(site.recording().messages("link/network"))
    return next(report for report in reports if report.src == ENDS[site.name]).fields()


@pytest.mark.check("two sites dial out, takes 20 s")
@pytest.mark.drawn(0.0, "services/relay/", "packages/telenano-wide-area/")
def test_both_sites_dial_out_and_find_the_way_past_the_relay(rig: RelayedSites, tmp_path: Path) -> None:
    rig.start_relay()
    rig.start("--duration", "600")
    rig.wait_until(lambda: both(rig, "as datagrams"), "datagrams both ways")
    rig.wait_until(lambda: both(rig, "go directly to"), "the direct way")
    for site in rig.sites:
        assert outside_listeners(site) == []
    heard = sniff(rig.master, 1.0, tmp_path / "wire")
    assert len(heard) > 10_000
    assert [text for text in IN_THE_CLEAR if text in heard] == []
    # To an end on a busy machine the line may seem full for a while, and then its reports have no datagrams.
    probe = "link", "probe", "--duration", "2", "--out", str(tmp_path / "probe")
    rig.wait_until(lambda: rig.master.telenano(*probe).returncode == 0, "a probe of the network", 60.0)
    # Samples could cross without the relay, but no emergency stop: the loop ends with it.
    rig.stop_relay()
    rig.wait_until(lambda: mode(rig) == "retracted", "a withdrawn tip", 30.0)
    rig.wait_until(lambda: both(rig, "no command can cross"), "the word of both ends")
    assert not rig.slave.has_log(ENDS["slave"], "continues over TCP")
    rig.start_relay()
    rig.wait_until(lambda: both(rig, "the link's datagrams continue"), "both sites in touch again")
    rig.rearm()
    rig.wait_until(lambda: mode(rig) == "follow", "a tip that follows again", 30.0)
    rig.end_session()


@pytest.mark.drawn(0.0, "telenano/recording/", "telenano/launcher/")
@pytest.mark.parametrize(
    "rig",
    [pytest.param(False, marks=pytest.mark.endurance, id="direct"), pytest.param(True, id="through the relay")],
    indirect=True,
)
def test_a_session_over_a_relay_is_whole_and_can_be_fetched_again(rig: RelayedSites) -> None:
    rig.start_relay()
    rig.start("--duration", "5")
    assert rig.master.process is not None
    assert rig.master.process.wait(timeout=120) == 0, rig.master.logs()
    summary = rig.master.summary()
    # The first contact may come too late in its hold to be at rest at its end, by what the relay adds.
    rests = summary["verdict"] == "stable"
    assert rests or not judged(summary, "the session over a relay"), summary["holds"]
    assert summary["recording"]["complete"] is True, summary["recording"]
    # The command that an interrupted fetch advises needs nothing that runs beside it.
    (fetched,) = (rig.master.out / "far").iterdir()
    fetched.unlink()
    again = rig.master.telenano("bag", "fetch", str(rig.master.out), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["messages"] == summary["recording"]["messages"]


@pytest.mark.drawn(0.0, "services/relay/", "services/delay_node/", "packages/telenano-wide-area/")
@pytest.mark.parametrize("rate_hz", [250, pytest.param(1000, marks=pytest.mark.endurance)])
@pytest.mark.parametrize("rig", [True], indirect=True)
def test_a_relay_that_is_killed_leaves_both_sides_safe_and_is_taken_up_again(rig: RelayedSites, rate_hz: int) -> None:
    for site in rig.sites:
        site.rate = ("--set", f"realtime.rate_hz={rate_hz}")
    rig.start_relay()
    rig.start("--duration", "600")
    rig.wait_until(lambda: both(rig, "as datagrams"), "datagrams both ways")
    # Routers that take another port for each address let no try past the relay.
    assert not any(site.has_log(ENDS[site.name], "go directly to") for site in rig.sites)
    gone_ns = time.time_ns()
    rig.stop_relay()

    def since(site: Site, topic: str, modes: set[str]) -> float | None:
        """Give when a device was first in a mode [s] after the relay was gone."""
        found = [m for m in site.recording().messages(topic, gone_ns) if m.fields()["mode"] in modes]
        return (found[0].log_ns - gone_ns) / NS_PER_S if found else None

    rig.wait_until(lambda: since(rig.slave, "afm/state", {"retracted"}) is not None, "a withdrawn tip")
    rig.wait_until(lambda: since(rig.master, "haptic/state", {"off"}) is not None, "a hand let go")
    held_s, let_go_s = since(rig.slave, "afm/state", {"hold"}), since(rig.master, "haptic/state", {"off"})
    withdrawn_s = since(rig.slave, "afm/state", {"retracted"})
    assert held_s is not None
    begin = time.monotonic()
    rig.start_relay()
    back_ns = time.time_ns()
    rig.wait_until(
        lambda: bool(rig.slave.recording().messages("teleop/forward@slave", back_ns)) or both(rig, "as datagrams", 2),
        "samples through the new relay",
    )
    rig.wait_until(lambda: both(rig, "as datagrams", 2), "datagrams through the new relay")
    back_s = time.monotonic() - begin
    rig.rearm()
    armed_ns = time.time_ns()
    rig.wait_until(
        lambda: any(m.fields()["mode"] == "follow" for m in rig.slave.recording().messages("afm/state", armed_ns)),
        "a tip that follows again",
    )
    rig.end_session()
    record(
        "the relay is killed and started again",
        f"at {rate_hz} Hz: tip held after {held_s * 1e3:.0f} ms, withdrawn after {withdrawn_s * 1e3:.0f} ms, hand off "
        f"after {let_go_s * 1e3:.0f} ms; datagrams again {back_s:.0f} s after its start command, armed and going on",
    )


@pytest.mark.endurance
@pytest.mark.parametrize("rig", [True], indirect=True)
def test_a_hostile_relay_reaches_no_node_and_is_counted(rig: RelayedSites) -> None:
    rig.start_relay(str(HOSTILE), "--listen", f"0.0.0.0:{PORT}")
    rig.start("--duration", "600")
    rig.wait_until(lambda: both(rig, "as datagrams"), "datagrams both ways")
    begin_ns = time.time_ns()
    time.sleep(4.0)
    reports = [newest_report(site) for site in rig.sites]
    for site, report in zip(rig.sites, reports, strict=True):
        assert {cause: report["refused"].get(cause, 0) > 50 for cause in ("forged", "replayed", "unknown_key")} == {
            "forged": True,
            "replayed": True,
            "unknown_key": True,
        }
        assert report["late"] > 20
        assert not site.has_log(ENDS[site.name], "continues over TCP")
    followed = [m.fields()["hand_t_ns"] for m in rig.slave.recording().messages("afm/state", begin_ns)]
    end_ns = time.time_ns()
    rig.wait_until(lambda: bool(rig.master.recording().messages("haptic/state", end_ns)), "the hand's recording")
    hands = {m.fields()["t_ns"] for m in rig.master.recording().messages("haptic/state", begin_ns - NS_PER_S)}
    # four seconds at 250 Hz, of which the relay drops some
    assert len(followed) > 500
    assert set(followed) <= hands
    assert all(before <= after for before, after in pairwise(followed))
    counted = [", ".join(f"{cause} {count}" for cause, count in report["refused"].items()) for report in reports]
    rig.end_session()
    record(
        "a relay that drops, repeats, holds back, forges and floods",
        f"the tip followed samples of the hand alone, none older than the one before; counted in some 6 s: "
        f"{counted[1]} at the slave's end",
    )

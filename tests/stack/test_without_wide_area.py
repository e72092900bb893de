"""Two sites of which one or both are without the package of the datagrams: they run over TCP, and say so once."""

import pytest
from stack_rig import judged
from two_sites import TwoSites, needs_namespaces

from telenano.recording.reader import Recording
from telenano.settings.known_packages import KNOWN_PACKAGES

pytestmark = [needs_namespaces, pytest.mark.stack, pytest.mark.endurance, pytest.mark.timeout(300)]

PACKAGE = KNOWN_PACKAGES["transport datagram"]
ENDS = {"master": "delay_node@master", "slave": "controller@slave"}
SAID = "the link sends no datagrams: "


@pytest.mark.parametrize("without", [("master", "slave"), ("master",), ("slave",)], ids=" and ".join)
def test_two_sites_run_over_tcp_where_the_package_is_missing(sites: TwoSites, without: tuple[str, ...]) -> None:
    for site in (sites.master, sites.slave):
        if site.name in without:
            site.environment["TELENANO_WITHOUT_PACKAGES"] = "1"
    sites.start("--duration", "5")
    assert sites.master.process is not None
    code = sites.master.process.wait(timeout=120)
    summary = sites.master.summary()
    sites.slave.stop()
    for site in (sites.master, sites.slave):
        log = (site.out / "logs" / f"{ENDS[site.name]}.log").read_text()
        assert log.count(SAID) == (site.name in without), log
        assert log.count(PACKAGE) == (site.name in without)
    topics = {message.channel_topic for message in Recording(sites.master.out / "session.mcap").messages()}
    assert ("link/network" in topics) == ("slave" not in without and "master" not in without)
    if "master" in without:
        # everything crossed beside the loop, and nothing is to be fetched
        assert code == 0, sites.master.logs()
        assert "afm/state" in topics and not (sites.master.out / "far").exists()
        assert summary["recording"]["complete"] is True, summary["recording"]
    else:
        # what sends the slave's recording is in the package as well
        assert (
            f"launcher@slave refuses: sending a recording is in the package {PACKAGE}" in sites.master.log.read_text()
        )
    assert summary["verdict"] == "stable" or not judged(summary, "the session over TCP") or "master" not in without

"""`telenano link show` between two machines, and the profiles."""

import json

from typer.testing import CliRunner

from telenano.cli.commands.link import network_rows
from telenano.cli.root import app


def test_what_the_network_did_is_shown_for_both_directions() -> None:
    clock = {"valid": True, "offset_s": 0.1, "uncertainty_s": 0.05, "round_trip_s": 0.1, "exchanges": 64}
    way = {
        "receiving": "datagram", "sent": 1000, "arrived": 980, "late": 3, "lost": 20, "refused": {"forged": 2},
        "delay_valid": True, "delay_min_s": 0.050, "delay_mean_s": 0.0502, "delay_max_s": 0.061, "clock": clock,
    }  # fmt: skip
    rows = {row["what"]: (row["forward"], row["backward"]) for row in network_rows({"forward": way})}
    assert rows["network: receiving"] == ("datagram", "")
    assert rows["network: lost"] == (20, "")
    assert rows["network: refused"][0] == "forged 2"
    assert rows["network: delay_mean_s"] == (0.0502, "")
    assert rows["network: delays known to ± [s]"] == (0.05, "")
    unknown = {row["what"]: row["forward"] for row in network_rows({"forward": {**way, "delay_valid": False}})}
    assert unknown["network: delay_mean_s"] == ""
    assert network_rows({}) == []


def test_a_way_on_which_udp_is_blocked_is_named_with_its_time() -> None:
    way = {"receiving": "stream", "sent": 10, "arrived": 10, "late": 0, "lost": 0, "settled": 0, "refused": {}}
    since_ns = 1_795_696_265 * 10**9
    ways = {"forward": {**way, "blocked_since_ns": None}, "backward": {**way, "blocked_since_ns": since_ns}}
    rows = {row["what"]: (row["forward"], row["backward"]) for row in network_rows(ways)}
    assert rows["network: UDP blocked since"] == ("", "12:31:05 UTC")
    assert "network: UDP blocked since" not in {row["what"] for row in network_rows({"forward": way, "backward": way})}


def test_the_state_of_the_line_is_shown_with_the_share_lost_of_what_is_settled() -> None:
    forward = {
        "receiving": "datagram", "sent": 1000, "arrived": 980, "late": 0, "lost": 20, "settled": 200, "refused": {},
        "delay_valid": False, "queue_s": 0.052, "capacity_bit_per_s": 1_040_000, "line": "free",
        "limit_bit_per_s": 6_000_000, "unsent": 0,
    }  # fmt: skip
    backward = {**forward, "queue_s": 0.001, "line": "full", "limit_bit_per_s": 850_000, "unsent": 300, "settled": 0}
    ways = {"forward": forward, "backward": backward}
    rows = {row["what"]: (row["forward"], row["backward"]) for row in network_rows(ways)}
    assert rows["network: lost, of those known [%]"] == ("10.0", "")
    assert rows["network: queue [ms]"] == ("52.0", "1.0")
    assert rows["network: line carries [Mbit/s]"] == ("1.04", "1.04")
    # the end that receives backward, at the master, is the one that sends forward
    assert rows["network: line"] == ("full", "free")
    assert rows["network: limit [Mbit/s]"] == ("0.85", "6")
    assert rows["network: unsent"] == ("300", "0")
    within = {"queue_low_s": 0.05, "queue_high_s": 0.06, "capacity_low_bit_per_s": 900_000}
    open_above = {**forward, **within, "capacity_high_bit_per_s": None}
    bounded = {**open_above, "capacity_high_bit_per_s": 1_200_000}
    rows = {row["what"]: row for row in network_rows({"forward": open_above, "backward": bounded})}
    assert rows["network: queue [ms]"]["forward"] == "52.0 (50.0 to 60.0)"
    assert rows["network: line carries [Mbit/s]"]["forward"] == "1.04 (0.9 or more)"
    assert rows["network: line carries [Mbit/s]"]["backward"] == "1.04 (0.9 to 1.2)"
    earlier = {key: forward[key] for key in ("receiving", "sent", "arrived", "late", "lost", "refused", "delay_valid")}
    shown = {row["what"]: row["forward"] for row in network_rows({"forward": earlier})}
    assert shown["network: queue [ms]"] == shown["network: line"] == shown["network: lost, of those known [%]"] == ""


def test_profiles_are_listed_and_shown_without_a_rig():
    listed = CliRunner().invoke(app, ["link", "profile", "--json"])
    names = [row["profile"] for row in json.loads(listed.stdout)["profiles"]]
    assert names[0] == "clean"
    assert {"wifi", "4g", "5g", "leo_satellite", "transatlantic", "netfi_delay_3"} <= set(names)
    shown = CliRunner().invoke(app, ["link", "profile", "WiFi", "--show"])
    assert shown.exit_code == 0
    for part in ("MobiSys 2016", "assumed", "statistics.forward.percentiles_ms", "forward.jitter.second_share"):
        assert part in shown.stdout
    found = json.loads(CliRunner().invoke(app, ["link", "profile", "5g", "--show", "--json"]).stdout)
    assert found["link"]["backward"]["delay_s"] == 0.0075
    unknown = CliRunner().invoke(app, ["link", "profile", "6g", "--show"])
    assert unknown.exit_code != 0
    assert "unknown profile '6g'; known are clean" in unknown.stderr

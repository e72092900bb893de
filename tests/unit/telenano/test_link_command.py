"""`telenano link show` between two machines."""

from telenano.cli.commands.link import network_rows


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

"""What `ping` printed drives the link: its delays as samples, or over time with `ping -D`, and what it lost."""

import pytest

from proto.errors import ConfigError
from services.delay_node.models.traces import parse_delay_trace, parse_jitter_table, parse_loss_trace

LINUX = """PING 192.0.2.1 (192.0.2.1) 56(84) bytes of data.
[1700000000.020000] 64 bytes from 192.0.2.1: icmp_seq=1 ttl=57 time=20.0 ms
[1700000000.240000] 64 bytes from 192.0.2.1: icmp_seq=2 ttl=57 time=40.0 ms
[1700000000.241000] 64 bytes from 192.0.2.1: icmp_seq=2 ttl=57 time=41.0 ms (DUP!)
no answer yet for icmp_seq=3
[1700000000.630000] 64 bytes from 192.0.2.1: icmp_seq=4 ttl=57 time=30.0 ms

--- 192.0.2.1 ping statistics ---
4 packets transmitted, 3 received, +1 duplicates, 25% packet loss, time 600ms
rtt min/avg/max/mdev = 20.000/30.000/40.000/8.165 ms
"""
OTHERS = {
    "macos": "PING a.example (192.0.2.1): 56 data bytes\n64 bytes from 192.0.2.1: icmp_seq=0 ttl=57 time=12.345 ms\n",
    "windows": "\nPinging 192.0.2.1 with 32 bytes of data:\nReply from 192.0.2.1: bytes=32 time=14ms TTL=117\n"
    "Request timed out.\nReply from 192.0.2.1: bytes=32 time<1ms TTL=117\n",
    "decimal comma": "64 octets de 192.0.2.1 : icmp_seq=1 ttl=57 temps=1 ms time=20,5 ms\n",
}


def test_the_samples_of_a_log_are_half_its_round_trips():
    assert parse_jitter_table(LINUX, "ping.txt") == pytest.approx((0.010, 0.020, 0.015), rel=1e-12)
    assert parse_jitter_table(OTHERS["macos"], "p") == pytest.approx((0.0061725,), rel=1e-12)
    assert parse_jitter_table(OTHERS["windows"], "p") == pytest.approx((0.007, 0.0005), rel=1e-12)
    assert parse_jitter_table(OTHERS["decimal comma"], "p") == pytest.approx((0.01025,), rel=1e-12)


def test_delay_and_loss_over_time_stand_at_the_times_of_sending():
    course = parse_delay_trace(LINUX, "ping.txt")
    assert [time / 1e9 for time in course.times_ns] == pytest.approx([0.0, 0.2, 0.6], abs=1e-6)
    assert [delay / 1e9 for delay in course.delays_ns] == pytest.approx([0.010, 0.020, 0.015], rel=1e-9)
    losses = parse_loss_trace(LINUX, "ping.txt")
    assert [time / 1e9 for time in losses.times_ns] == pytest.approx([0.0, 0.2, 0.4, 0.6], abs=1e-6)
    assert losses.lost == (False, False, True, False)


@pytest.mark.parametrize(
    ("parse", "text", "reason"),
    [
        (parse_delay_trace, OTHERS["macos"], r"p, line 2: has no time; let `ping -D` print one"),
        (parse_loss_trace, OTHERS["windows"], r"p, line 3: has no time"),
        (parse_jitter_table, "PING 192.0.2.1 (192.0.2.1) 56(84) bytes of data.\n", "p: is a log of ping without"),
        (parse_loss_trace, "[1.5] Reply from 192.0.2.1: time=14ms TTL=117\n", "line 1: has no icmp_seq"),
    ],
)
def test_a_log_that_cannot_serve_is_refused_with_its_line(parse, text, reason):
    with pytest.raises(ConfigError, match=reason):
        parse(text, "p")


@pytest.mark.parametrize("parse", [parse_delay_trace, parse_loss_trace])
def test_a_fault_of_a_log_is_told_by_its_own_line(parse):
    # header, a duplicate and a line of another kind stand before it: line 6 of the log is its third answer
    at_once = LINUX.replace("[1700000000.630000]", "[1700000000.240000]").replace("time=30.0", "time=40.0")
    with pytest.raises(ConfigError, match=r"^ping.txt, line 6: the time is not later than the one before it$"):
        parse(at_once, "ping.txt")


def test_a_delay_of_a_log_beyond_an_hour_is_refused_with_its_line():
    with pytest.raises(ConfigError, match=r"^ping.txt, line 3: is not a number from 0 to 3600$"):
        parse_delay_trace(LINUX.replace("time=40.0", "time=40000000.0"), "ping.txt")

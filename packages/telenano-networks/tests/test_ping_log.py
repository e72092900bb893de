"""What `ping -D` printed becomes the round trip of each packet at its time, and what it lost."""

import math

import numpy as np
import pytest
from telenano_networks.ping_log import is_ping_log, round_trips

from proto.errors import ConfigError

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


def test_the_round_trips_stand_at_the_times_of_sending_and_a_packet_without_answer_between_its_neighbours() -> None:
    rows = round_trips(LINUX, "ping.txt")
    assert [row[0] for row in rows] == pytest.approx([0.0, 0.2, 0.4, 0.6], abs=1e-6)
    assert [row[1] for row in rows[:2]] == pytest.approx([0.020, 0.040], rel=1e-12)
    assert math.isnan(rows[2][1])


def test_the_number_of_a_packet_goes_on_after_sixteen_bits() -> None:
    lines = [f"[{1700000000 + n}.0] 64 bytes: icmp_seq={(65530 + n) % 65536} ttl=57 time=20 ms" for n in range(12)]
    assert [row[0] for row in round_trips("\n".join(lines), "p")] == pytest.approx(list(range(12)))


@pytest.mark.parametrize("said", ["time=42 ms", "Zeit=42ms", "temps=42,0 ms", "tiempo=42.0 ms", "время=42 мс"])
def test_the_time_is_read_in_other_languages(said: str) -> None:
    line = f"[1700000000.042000] 64 Bytes von 192.0.2.1: icmp_seq=1 ttl=57 {said}"
    assert round_trips(line, "p") == [(0.0, 0.042)]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("PING a (1)\n64 bytes from a: icmp_seq=0 ttl=57 time=12.345 ms\n", "p, line 2: has no time; let `ping -D`"),
        ("Pinging a\nReply from a: bytes=32 time<1ms TTL=117\n", "p, line 2: has no icmp_seq"),
    ],
)
def test_a_log_that_cannot_serve_is_refused_with_its_line(text: str, reason: str) -> None:
    assert is_ping_log(text)
    with pytest.raises(ConfigError, match=reason):
        round_trips(text, "p")


def test_dates_before_the_lines_are_times_and_without_any_the_last_lines_say_how_long_all_took() -> None:
    dated = "".join(
        f"[2024-05-27 15:17:0{n}.250000] 46 bytes from a: icmp_seq={n + 1} ttl=58 time=50.0 ms\n" for n in range(3)
    )
    rows = round_trips("Start time: 1\n[2024-05-27 15:17:00.100000] PING a (a) 38(66) bytes of data.\n" + dated, "p")
    assert rows == pytest.approx(np.array([(0.0, 0.05), (1.0, 0.05), (2.0, 0.05)]))
    bare = "PING a (a)\n64 bytes from a: icmp_seq=1 ttl=4 time=5 ms\n64 bytes from a: icmp_seq=3 ttl=4 time=7 ms\n"
    rows = round_trips(bare + "3 packets transmitted, 2 received, 33% packet loss, time 2020ms\n", "p")
    assert [row[0] for row in rows] == pytest.approx([0.0, 1.01, 2.02], abs=1e-9) or rows[2][0] == pytest.approx(1.01)
    assert round_trips("PING 192.0.2.1 (192.0.2.1) 56(84) bytes of data.\n", "p") == []

"""What `ping -D` printed becomes the round trip of each packet at its time, and what it lost."""

import math
import time
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.networks.line_log import read_log
from telenano_lab.networks.ping_log import is_ping_log, round_trips

from telenano.wire import ConfigError

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


def only(text: str, name: str, period_s: float | None = None) -> list[tuple[float, float]]:
    (rows,) = round_trips(text, name, period_s).parts
    return rows


def test_the_round_trips_stand_at_the_times_of_sending_and_a_packet_without_answer_between_its_neighbours() -> None:
    rows = only(LINUX, "ping.txt")
    assert [row[0] for row in rows] == pytest.approx([0.0, 0.2, 0.4, 0.6], abs=1e-6)
    assert [row[1] for row in rows[:2]] == pytest.approx([0.020, 0.040], rel=1e-12)
    assert math.isnan(rows[2][1])


def test_the_number_of_a_packet_goes_on_after_sixteen_bits() -> None:
    lines = [f"[{1700000000 + n}.0] 64 bytes: icmp_seq={(65530 + n) % 65536} ttl=57 time=20 ms" for n in range(12)]
    assert [row[0] for row in only("\n".join(lines), "p")] == pytest.approx(list(range(12)))


@pytest.mark.parametrize("said", ["time=42 ms", "Zeit=42ms", "temps=42,0 ms", "tiempo=42.0 ms", "время=42 мс"])
def test_the_time_is_read_in_other_languages(said: str) -> None:
    line = f"[1700000000.042000] 64 Bytes von 192.0.2.1: icmp_seq=1 ttl=57 {said}"
    assert only(line, "p") == [(0.0, 0.042)]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("PING a (1)\n64 bytes from a: icmp_seq=0 ttl=57 time=12.345 ms\n", "p, line 2: has no time; let `ping -D`"),
        ("PING a (1)\nreply of a router time=12 ms\n", "p, line 2: has no icmp_seq"),
        (
            "PING a\n[1.0] 64 bytes: icmp_seq=" + 50 * "9" + " time=1 ms\n",
            "p, line 2: icmp_seq=9+… is the number of no",
        ),
        (
            "PING a\n[2026-13-45 10:00:00] 64 bytes: icmp_seq=1 time=1 ms\n",
            "p, line 2: '2026-13-45 10:00:00' is not a time",
        ),
        (
            "PING a\n[1.0] 64 bytes: icmp_seq=1 time=1 ms\n[2.0] 64 bytes: icmp_seq=4000000000 time=1 ms\n",
            "p, line 3: icmp_seq=4000000000 is 3999999999 packets after the one before",
        ),
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
    rows = only("Start time: 1\n[2024-05-27 15:17:00.100000] PING a (a) 38(66) bytes of data.\n" + dated, "p")
    assert rows == pytest.approx(np.array([(0.0, 0.05), (1.0, 0.05), (2.0, 0.05)]))
    bare = "PING a (a)\n64 bytes from a: icmp_seq=1 ttl=4 time=5 ms\n64 bytes from a: icmp_seq=3 ttl=4 time=7 ms\n"
    rows = only(bare + "3 packets transmitted, 2 received, 33% packet loss, time 2020ms\n", "p")
    assert [row[0] for row in rows] == pytest.approx([0.0, 1.01, 2.02], abs=1e-9) or rows[2][0] == pytest.approx(1.01)
    assert round_trips("PING 192.0.2.1 (192.0.2.1) 56(84) bytes of data.\n", "p").parts == []


def printed(
    lost: set[int],
    count: int = 400,
    begin: float = 1.7e9,
    *,
    head: bool = True,
    total: bool = True,
    names: bool = False,
) -> str:
    """Return what ping prints of packets each 0.1 s, of which some are lost and perhaps named."""
    rows = ["PING h (192.0.2.1) 56(84) bytes of data."] if head else []
    for n in range(1, count + 1):
        if n not in lost:
            rows.append(f"[{begin + 0.1 * n + 0.02:.6f}] 64 bytes from h: icmp_seq={n % 65536} ttl=57 time=20.0 ms")
        elif names:
            rows.append(f"[{begin + 0.1 * n + 1.0:.6f}] no answer yet for icmp_seq={n % 65536}")
    if total:
        rows.append(f"{count} packets transmitted, {count - len(lost)} received, time {100 * (count - 1)}ms")
    return "\n".join([*rows, ""])


LOST = {
    "first half": range(1, 201),
    "last half": range(201, 401),
    "middle": range(100, 300),
    "ends": (*range(1, 50), 400),
}


@pytest.mark.parametrize("where", LOST)
@pytest.mark.parametrize(("total", "names", "head"), [(True, False, True), (False, True, True), (False, True, False)])
def test_what_is_lost_before_the_first_answer_and_after_the_last_is_counted(
    where: str, total: bool, names: bool, head: bool
) -> None:
    rows = only(printed(set(LOST[where]), total=total, names=names, head=head), "p")
    assert len(rows) == 400
    lost = {n for n, row in enumerate(rows, start=1) if math.isnan(row[1])}
    assert lost == set(LOST[where])
    assert [row[0] for row in rows] == pytest.approx([0.1 * n for n in range(400)], abs=1e-6)


@pytest.mark.parametrize("head", [True, False])
@pytest.mark.parametrize("counts", [(400, 400), (100, 700), (700, 100), (300, 200, 400)])
def test_each_run_in_a_file_is_a_part_of_its_own(counts: tuple[int, ...], head: bool) -> None:
    text = "".join(printed({7}, n, 1.7e9 + 3600.0 * place, head=head, total=head) for place, n in enumerate(counts))
    found = round_trips(text, "p")
    assert [len(part) for part in found.parts] == list(counts)
    assert all(sum(math.isnan(row[1]) for row in part) == 1 for part in found.parts)
    assert "each is a part of its own" in found.remarks[0]


WINDOWS = {
    "de": ("Ping wird ausgeführt für a [192.0.2.1] mit 32 Bytes Daten:",
           "Antwort von 192.0.2.1: Bytes=32 Zeit{}ms TTL=57",
           "Zeitüberschreitung der Anforderung.", "Ping-Statistik für 192.0.2.1:"),
    "en": ("Pinging a [192.0.2.1] with 32 bytes of data:", "Reply from 192.0.2.1: bytes=32 time{}ms TTL=57",
           "Request timed out.", "Ping statistics for 192.0.2.1:"),
    "fr": ("Envoi d’une requête 'ping' sur a [192.0.2.1] avec 32 octets de données :",
           "Réponse de 192.0.2.1 : octets=32 temps{} ms TTL=57",
           "Délai d’attente de la demande dépassé.",
           "Statistiques Ping pour 192.0.2.1:"),
    "zh": ("正在 Ping a [192.0.2.1] 具有 32 字节的数据:",
           "来自 192.0.2.1 的回复: 字节=32 时间{}ms TTL=57", "请求超时。",
           "192.0.2.1 的 Ping 统计信息:"),
    "ja": ("192.0.2.1 に ping を送信しています 32 バイトのデータ:",
           "192.0.2.1 からの応答: バイト数 =32 時間 {}ms TTL=57",
           "要求がタイムアウトしました。", "192.0.2.1 の ping 統計:"),
    "ru": ("Обмен пакетами с a [192.0.2.1] с 32 байтами данных:",
           "Ответ от 192.0.2.1: число байт=32 время{}мс TTL=57",
           "Превышен интервал ожидания для запроса.", "Статистика Ping для 192.0.2.1:"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("answer", "lost"),
    [
        ("64 bytes from 192.0.2.1: seq={} ttl=57 time=41.3 ms", ""),
        ("192.0.2.1 : [{}], 64 bytes, 41.3 ms (41.0 avg, 0% loss)", "192.0.2.1 : [{}], timed out (41.0 avg, 9% loss)"),
        ("64 bytes from 192.0.2.1: icmp_seq={} ttl=57 time=41.3 ms", "Request timeout for icmp_seq {}"),
    ],
)
def test_the_lines_of_other_pings_have_numbers_of_their_own(answer: str, lost: str) -> None:
    gone = {7, 8, 300}
    rows = [(lost if n in gone else answer).format(n) for n in range(400)]
    found = only("\n".join([row for row in rows if row] + [""]), "p", 1.0)
    assert {n for n, row in enumerate(found) if math.isnan(row[1])} == gone
    assert {round(1e6 * row[1]) for row in found if not math.isnan(row[1])} == {41300}


@pytest.mark.parametrize(
    ("language", "encoding"),
    [("en", "utf-16"), ("zh", "utf-16"), ("ja", "shift_jis"), ("ru", "cp1251"), ("fr", "cp1252")],
)
def test_what_a_shell_of_windows_keeps_is_read_in_its_character_set(
    language: str, encoding: str, tmp_path: Path
) -> None:
    head, answer, lost, statistics = WINDOWS[language]
    rows = [lost if n % 9 == 4 else answer.format(f"={20 + n % 5}") for n in range(400)]
    (tmp_path / "log.txt").write_bytes("\r\n".join(["", head, *rows, "", statistics, ""]).encode(encoding))
    log = read_log([tmp_path / "log.txt"])
    (part,) = log.segments
    assert log.round_trip
    assert (len(part.sent_s), int(np.isnan(part.delay_s).sum())) == (400, 44)


@pytest.mark.parametrize("language", WINDOWS)
def test_the_lines_of_windows_are_a_sequence_in_any_language(language: str) -> None:
    head, answer, lost, statistics = WINDOWS[language]
    draw = np.random.default_rng(1)
    trips = [int(v) if v > 2 else 0 for v in draw.normal(20, 9, 200)]
    rows = [lost if n % 9 == 4 or n > 180 else answer.format(f"={t}" if t else "<1") for n, t in enumerate(trips)]
    text = "\r\n".join(["", head, *rows, "", statistics, "    Minimum = 0ms, Maximum = 50ms", ""])
    assert is_ping_log(text)
    found = only(text, "p")
    wanted = [math.nan if n % 9 == 4 or n > 180 else 1e-3 * max(t, 1) for n, t in enumerate(trips)]
    np.testing.assert_allclose([row[1] for row in found], wanted)
    assert all(np.diff([row[0] for row in found]) > 0.0)


def test_the_time_of_reading_grows_with_the_lines_and_not_with_their_square() -> None:
    took = []
    for count in (5_000, 40_000):
        text = printed({9}, count)
        begin = time.process_time()
        assert len(only(text, "p")) == count
        took.append(time.process_time() - begin)
    assert took[1] < 30.0 * took[0]

"""A log of a line that is damaged, or says sizes that no line has, ends in a sentence, and takes no memory for them."""

from pathlib import Path

import numpy as np
import pytest
from telenano_lab.networks.line_log import read_log

from telenano.wire import TelenanoError

PINGED = "PING a (1)\n" + "".join(
    f"[{1.7e9 + 0.1 * n:.6f}] 64 bytes from a: icmp_seq={n} ttl=57 time=2{n % 7}.5 ms\n" for n in range(1, 400)
)
TABLE = "sent_ms;delay_ms\n" + "".join(f"{100 * n};{20 + n % 7}.5\n" for n in range(400))
TRACE = "".join(f"{4 * n}\n" for n in range(1, 9000))

BOMBS = {
    "icmp_seq of 4e9": "PING a\n[1.0] 64 bytes: icmp_seq=1 time=1 ms\n[2.0] 64 bytes: icmp_seq=4000000000 time=1 ms\n",
    "icmp_seq named alone": "PING a\n[1.0] 64 bytes: icmp_seq=1 time=1 ms\n"
    "[2.0] no answer yet for icmp_seq=4000000000\n",
    "icmp_seq of 5000 digits": "PING a\n[1.0] 64 bytes: icmp_seq=" + 5000 * "9" + " time=1 ms\n",
    "time of 400 digits": "PING a\n[1.0] 64 bytes: icmp_seq=1 time=" + 400 * "9" + " ms\n",
    "trace to 1e15": "".join(f"{4 * n}\n" for n in range(1, 200)) + "1000000000000000\n",
    "trace of 30 digits": "".join(f"{4 * n}\n" for n in range(1, 200)) + 30 * "9" + "\n",
    "trace with a square": TRACE + "4000²\n",
    "messages 1e9 s apart": "sent_s,delay_ms\n" + "".join(f"{n}e9,20\n" for n in range(400)),
    "quoted field of 200 kB": 'sent_s,delay_ms\n"' + 200_000 * "1" + '",20\n',
    "date of month 13": "PING a\n[2026-13-45 10:00:00] 64 bytes: icmp_seq=1 time=1 ms\n",
    "total of 4e9": "PING a\n"
    + PINGED[:200]
    + "4000000000 packets transmitted, 2 received, 99% packet loss, time 1ms\n",
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_size_that_a_value_says_is_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text(BOMBS[name], encoding="utf-8")
    with pytest.raises(TelenanoError, match=r"log\.txt|too few|is no|are no"):
        read_log([path])


@pytest.mark.parametrize("kind", ["ping", "table", "trace"])
def test_200_damaged_logs_are_read_or_refused_and_never_fail(kind: str, tmp_path: Path) -> None:
    whole = {"ping": PINGED, "table": TABLE, "trace": TRACE}[kind].encode()
    draw = np.random.default_rng([1, len(kind)])
    path, taken = tmp_path / "log.txt", 0
    for _ in range(200):
        content = bytearray(whole)
        for place in draw.integers(len(content), size=draw.integers(1, 6)):
            content[place] = draw.integers(256)
        cut = draw.integers(len(content)) if draw.random() < 0.3 else len(content)
        path.write_bytes(bytes(content[:cut]))
        try:
            log = read_log([path])
        except TelenanoError:
            continue
        taken += 1
        assert sum(len(part.sent_s) for part in log.segments) < 1000 * len(whole)
    # a byte among the numbers of a table is refused with its line, one in the words of ping is not
    assert taken > (20 if kind == "ping" else 0)

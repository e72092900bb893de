"""Made-up text files in the formats of other programs, with the true values in each.

The layouts are those of the named programs, made from their public descriptions; the numbers are random. A kind is a
function of a random generator that returns the name of the file, its bytes and the true values.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

Array = np.ndarray
K_N_PER_M, M_PER_V = 0.5, 50e-9
POINTS = 300


class Made(NamedTuple):
    """Name and content of a file; its kind ("curve", "spectrum", "sensitivity" or "line"), and its true values.

    truth: for a curve the pull-off and the greatest force [N] and the span of the height [m]; for a spectrum the first
    and last line [Hz] and the density in the peak [V^2/Hz, m^2/Hz]; for a sensitivity nm/V; for a line the numbers of
    messages and lost messages, the median delay [s], the period [s] and whether delays are round trips.
    asked: options that a person must give, by the message that asks for them.
    """

    name: str
    content: bytes
    what: str
    truth: dict[str, float]
    asked: Mapping[str, str] = MappingProxyType({})


def force(height_m: Array, pull_n: float) -> Array:
    return np.where(height_m < 0.0, -K_N_PER_M * height_m, 0.0) - pull_n * np.exp(-np.abs(height_m) / 5e-9)


def ways(draw: np.random.Generator) -> tuple[Array, Array, Array, dict[str, float]]:
    """Return heights [m] of an approach, forces [N] of approach and retraction there, and the true values."""
    deep = draw.uniform(30e-9, 90e-9)
    height = np.linspace(draw.uniform(150e-9, 300e-9), -deep, POINTS)
    pull = draw.uniform(4e-9, 12e-9)
    there, back = force(height, 0.2 * pull), force(height, pull)
    truth = {"pull_off_n": float(back.min()), "greatest_n": float(max(there.max(), back.max())),
             "span_m": float(np.ptp(height))}  # fmt: skip
    return height, there, back, truth


def rows(columns: Sequence[Array], separator: str = "\t", form: str = "{:.6e}", mark: str = ".") -> str:
    lines = (separator.join(form.format(value) for value in row) for row in zip(*columns, strict=True))
    return "".join(f"{line.replace('.', mark)}\n" for line in lines)


def jpk_export(draw: np.random.Generator) -> Made:
    """JPK Data Processing: comments with names and units, segments one after another, heights in m and forces in N."""
    height, there, back, truth = ways(draw)
    text = "# exportSettings.xAxisUnit: m\n# springConstant: 0.5\n"
    for name, z, f in (("extend", height, there), ("retract", height[::-1], back[::-1])):
        seconds = np.arange(len(z)) * 1e-3
        text += f"#\n# segment: {name}\n# columns: height vDeflection seriesTime segmentTime\n"
        text += '# fancyNames: "Height" "Vertical deflection" "Series Time" "Segment Time"\n# units: m N s s\n'
        text += rows((z, f, seconds, seconds), " ")
    return Made("force-save.txt", text.encode(), "curve", truth)


def nanoscope_export(draw: np.random.Generator) -> Made:
    """NanoScope Analysis: quoted names with units at their end, both ways side by side."""
    height, there, back, truth = ways(draw)
    names = ("Calc_Ramp_Ex_nm", "Calc_Ramp_Rt_nm", "Defl_pN_Ex", "Defl_pN_Rt")
    text = "\t".join(f'"{name}"' for name in names) + "\n"
    text += rows((1e9 * height, 1e9 * height, 1e12 * there, 1e12 * back))
    return Made("bruker.txt", text.replace("\n", "\r\n").encode(), "curve", truth)


def igor_text(draw: np.random.Generator) -> Made:
    """Igor's text of waves: IGOR, WAVES with names, BEGIN and END."""
    height, there, back, truth = ways(draw)
    z, f = np.concatenate([height, height[::-1]]), np.concatenate([there, back[::-1]])
    text = f'IGOR\nWAVES/D\tZSnsr, Force\nBEGIN\n{rows((z, f))}END\nX SetScale d 0,0,"m", ZSnsr\n'
    return Made("curve.itx.txt", text.encode(), "curve", truth, {"way_unit": "m", "value_unit": "N"})


def park_export(draw: np.random.Generator) -> Made:
    """XEI and SmartScan: a head of facts, names on one line and units on the next."""
    height, there, back, truth = ways(draw)
    z, f = np.concatenate([height, height[::-1]]), np.concatenate([there, back[::-1]])
    head = f"F/D curve\nSpring constant\t0.5 N/m\nPoints\t{len(z)}\n\nIndex\tZ Detector\tForce\n\tum\tnN\n"
    text = head + rows((np.arange(len(z)), 1e6 * z, 1e9 * f), form="{:.7g}")
    return Made("park.txt", text.encode("utf-8-sig"), "curve", truth)


def german_semicolons(draw: np.random.Generator) -> Made:
    """A spreadsheet of a German laboratory: semicolons, decimal commas, an older character set, trailing semicolons."""
    height, there, back, truth = ways(draw)
    z, f = np.concatenate([height, height[::-1]]), np.concatenate([there, back[::-1]])
    text = rows((1e6 * z, 1e9 * f), ";", "{:.7f}", ",").replace("\n", ";\r\n")
    return Made("kurve.csv", f"Höhe [µm];Kraft [nN];\r\n{text}".encode("cp1252"), "curve", truth)


def french_table(draw: np.random.Generator) -> Made:
    """A French table: words with accents, units in brackets, decimal commas and tabs."""
    height, there, back, truth = ways(draw)
    z, f = np.concatenate([height, height[::-1]]), np.concatenate([there, back[::-1]])
    text = "Courbe de force\nÉchantillon : mica\n\nDistance (nm)\tForce (pN)\n"
    return Made("courbe.txt", (text + rows((1e9 * z, 1e12 * f), "\t", "{:.5f}", ",")).encode(), "curve", truth)


def utf16_table(draw: np.random.Generator) -> Made:
    """The Unicode text of a spreadsheet: UTF-16 with byte order mark, CRLF, tabs, quoted heads."""
    height, there, back, truth = ways(draw)
    z, f = np.concatenate([height, height[::-1]]), np.concatenate([there, back[::-1]])
    text = '"Z, measured [nm]"\t"Force, vertical [nN]"\n' + rows((1e9 * z, 1e9 * f), form="{:.5f}")
    return Made("unicode.txt", text.replace("\n", "\r\n").encode("utf-16"), "curve", truth)


def two_heads(draw: np.random.Generator) -> Made:
    """Two rows of heads, approach or retract above the names, and a row of units after them."""
    height, there, back, truth = ways(draw)
    text = "approach;approach;retract;retract\nz;F;z;F\nnm;nN;nm;nN\n"
    text += rows((1e9 * height, 1e9 * there, 1e9 * height, 1e9 * back), ";", "{:.5f}")
    return Made("two_heads.csv", text.encode(), "curve", truth)


def deflection_by_stiffness(draw: np.random.Generator) -> Made:
    """A deflection in mV, with a force per volt in the head, which is not the unit of a column."""
    height, there, back, truth = ways(draw)
    z, f = np.concatenate([height, height[::-1]]), np.concatenate([there, back[::-1]])
    text = "# InvOLS: 50 nm/V\n# Conversion: 25 nN/V\nZ sensor/nm,Deflection/mV\n"
    text += rows((1e9 * z, 1e3 * f / (K_N_PER_M * M_PER_V)), ",", "{:.6f}")
    return Made("defl.csv", text.encode(), "curve", truth)


def unit_row_at_the_end(draw: np.random.Generator) -> Made:
    """A row of units after the numbers, like the footer of some sheets."""
    height, there, back, truth = ways(draw)
    z, f = np.concatenate([height, height[::-1]]), np.concatenate([there, back[::-1]])
    text = "z,force\n" + rows((1e9 * z, 1e9 * f), ",", "{:.5f}") + "nm,nN\n"
    return Made("foot.csv", text.encode(), "curve", truth)


def thermal(draw: np.random.Generator) -> tuple[Array, Array, dict[str, float]]:
    f0, q = draw.uniform(12e3, 300e3), draw.uniform(30.0, 300.0)
    frequency = np.linspace(0.0, 3.0 * f0, 1501)[1:]
    x = frequency / f0
    density = 1e-12 + 1e-9 / ((1.0 - x**2) ** 2 + (x / q) ** 2) / q**2
    peak = float(density.max())
    return frequency, density, {"first_hz": float(frequency[0]), "last_hz": float(frequency[-1]), "peak": peak}


def zurich(draw: np.random.Generator) -> Made:
    """LabOne's comma-separated sheet: comments with %, names with units in brackets."""
    frequency, density, truth = thermal(draw)
    text = "% LabOne spectrum\n% Timebase: 2.1e8\n% Frequency (Hz), PSD (V²/Hz)\n" + rows((frequency, density), ", ")
    return Made("spectrum.csv", text.encode(), "spectrum", truth)


def sr760(draw: np.random.Generator) -> Made:
    """An SR760 dumps lines and amplitudes in dBV/√Hz, which is no linear density."""
    frequency, density, truth = thermal(draw)
    text = "FREQ(Hz)\tPSD(dBV/rtHz)\n" + rows((frequency, 10.0 * np.log10(density)), form="{:.6g}")
    return Made("sr760.txt", text.encode(), "spectrum", truth)


def analyser_dbm(draw: np.random.Generator) -> Made:
    """A spectrum analyser's trace in dBm/Hz."""
    frequency, density, truth = thermal(draw)
    text = "Type;FSV\nCenter Freq;100000;Hz\nFrequency [Hz];Level [dBm/Hz]\n"
    text += rows((frequency, 10.0 * np.log10(density / 0.05)), ";", "{:.6f}")
    return Made("trace.dat", text.encode(), "spectrum", truth)


def hp35670(draw: np.random.Generator) -> Made:
    """An HP35670's sheet: header lines of names and values, then frequency and Vrms/rtHz."""
    frequency, density, truth = thermal(draw)
    text = '"HP35670A"\n"Trace A: PSD1"\n"X: Hz","Y: V/rtHz"\n' + rows((frequency, np.sqrt(density)), ",")
    return Made("hp35670.csv", text.encode(), "spectrum", truth)


def asylum_thermal(draw: np.random.Generator) -> Made:
    """A thermal graph of Igor with pm/√Hz over kHz, scales in the names."""
    frequency, density, truth = thermal(draw)
    density = density * 1e-18
    text = "Frequency_kHz\tAmplitude (pm/√Hz)\n" + rows((1e-3 * frequency, 1e12 * np.sqrt(density)), form="{:.7g}")
    return Made("thermal.txt", text.encode(), "spectrum", {**truth, "peak": truth["peak"] * 1e-18})


def transposed(draw: np.random.Generator) -> Made:
    """A spectrum with its lines in two rows, as in a transposed sheet."""
    frequency, density, truth = thermal(draw)
    text = "".join(
        f"{name};{';'.join(f'{value:.6e}' for value in values)}\n"
        for name, values in (("f [Hz]", frequency), ("PSD [V^2/Hz]", density))
    )
    return Made("transposed.csv", text.encode(), "spectrum", truth)


def magnitude_and_phase(draw: np.random.Generator) -> Made:
    """A sweep with a phase in degrees beside the density."""
    frequency, density, truth = thermal(draw)
    phase = np.degrees(np.arctan2(1.0, frequency / frequency.mean() - 1.0))
    text = "Freq. [kHz];Phase [deg];PSD [mV²/Hz]\n" + rows((1e-3 * frequency, phase, 1e6 * density), ";", "{:.7e}", ",")
    return Made("sweep.csv", text.encode(), "spectrum", truth)


def hard_curve(draw: np.random.Generator) -> Made:
    """A curve on a hard sample with both the lateral and the vertical signal in volts."""
    nm_per_v = draw.uniform(20.0, 150.0)
    way = np.linspace(0.0, 400.0, 400)
    volts = np.maximum(way - 150.0, 0.0) / nm_per_v
    lateral = 0.01 * draw.standard_normal(len(way))
    text = "Piezo [nm]\tLateral [V]\tDeflection [V]\n" + rows((way, lateral, volts), form="{:.6f}")
    return Made("hard.txt", text.encode(), "sensitivity", {"nm_per_v": nm_per_v})


def trips(draw: np.random.Generator, count: int = 600) -> tuple[Array, Array]:
    """Return round trips [ms] of packets, and whether each is lost; the first two and last two never are."""
    ms = np.round(draw.uniform(8.0, 60.0) + draw.gamma(2.0, 1.5, count), 1)
    lost = draw.random(count) < 0.05
    lost[[0, 1, -2, -1]] = False
    return ms, lost


def line(ms: Array, lost: Array, period_s: float, is_trip: bool = True) -> dict[str, float]:
    return {"count": float(len(ms)), "lost": float(lost.sum()), "median_s": 1e-3 * float(np.median(ms[~lost])),
            "period_s": period_s, "is_trip": float(is_trip)}  # fmt: skip


def _pinged(each: Callable[[int, float, bool], str], head: str, foot: str, ms: Array, lost: Array) -> bytes:
    lines = [each(n, float(one), bool(gone)) for n, (one, gone) in enumerate(zip(ms, lost, strict=True))]
    return "\n".join([head, *(text for text in lines if text), *foot.splitlines(), ""]).encode()


def macos_ping(draw: np.random.Generator) -> Made:
    """Ping of macOS: numbers from 0, and a line for each time-out."""
    ms, lost = trips(draw)
    content = _pinged(
        lambda n, one, gone: f"Request timeout for icmp_seq {n}" if gone
        else f"64 bytes from 1.1.1.1: icmp_seq={n} ttl=58 time={one:.3f} ms",
        "PING 1.1.1.1 (1.1.1.1): 56 data bytes",
        f"\n--- 1.1.1.1 ping statistics ---\n{len(ms)} packets transmitted, {int((~lost).sum())} packets received,"
        f" {100.0 * lost.mean():.1f}% packet loss\n", ms, lost,
    )  # fmt: skip
    return Made("mac.txt", content, "line", line(ms, lost, 1.0), {"period_s": "1.0"})


def ping6_dated(draw: np.random.Generator) -> Made:
    """Ping of IPv6 with -D and -O: a time stamp, hop limit, and a line for each packet not answered yet."""
    ms, lost = trips(draw)

    def each(n: int, one: float, gone: bool) -> str:
        stamp = f"[{1.76e9 + 0.2 * n + (0.0 if gone else 1e-3 * one):.6f}]"
        return f"{stamp} no answer yet for icmp_seq={n + 1}" if gone else (
            f"{stamp} 64 bytes from 2606:4700::1111: icmp_seq={n + 1} hlim=57 time={one:.1f} ms"
        )  # fmt: skip

    head = "PING 2606:4700::1111(2606:4700::1111) 56 data bytes"
    return Made("ping6.txt", _pinged(each, head, "", ms, lost), "line", line(ms, lost, 0.2))


def german_windows(draw: np.random.Generator) -> Made:
    """Ping of a German Windows: whole milliseconds, and a sentence for a time-out."""
    ms, lost = trips(draw)
    ms = np.round(ms)
    content = _pinged(
        lambda n, one, gone: "Zeitüberschreitung der Anforderung." if gone
        else f"Antwort von 1.1.1.1: Bytes=32 Zeit={one:.0f}ms TTL=57",
        "\nPing wird ausgeführt für 1.1.1.1 mit 32 Bytes Daten:", "\nPing-Statistik für 1.1.1.1:\n", ms, lost,
    )  # fmt: skip
    return Made("windows.txt", content.decode().encode("cp1252"), "line", line(ms, lost, 1.0))


def french_linux(draw: np.random.Generator) -> Made:
    """Ping of a French Linux: `temps=`, decimal comma, totals in French."""
    ms, lost = trips(draw)
    content = _pinged(
        lambda n, one, gone: "" if gone
        else f"[{1.76e9 + 0.5 * n + 1e-3 * one:.6f}] 64 octets de 1.1.1.1 : icmp_seq={n + 1} ttl=57"
        f" temps={str(one).replace('.', ',')} ms",
        "PING 1.1.1.1 (1.1.1.1) 56(84) octets de données.",
        f"\n--- statistiques ping 1.1.1.1 ---\n{len(ms)} paquets transmis, {int((~lost).sum())} reçus\n", ms, lost,
    )  # fmt: skip
    return Made("ping_fr.txt", content, "line", line(ms, lost, 0.5))


def hping(draw: np.random.Generator) -> Made:
    """Hping3: rtt= and seq=, no stamps, totals without a time."""
    ms, lost = trips(draw)
    content = _pinged(
        lambda n, one, gone: "" if gone
        else f"len=46 ip=10.0.0.2 ttl=64 DF id=0 sport=80 flags=SA seq={n} win=64240 rtt={one:.1f} ms",
        "HPING 10.0.0.2 (eth0 10.0.0.2): S set, 40 headers + 0 data bytes",
        f"\n--- 10.0.0.2 hping statistic ---\n{len(ms)} packets transmitted, {int((~lost).sum())} packets received,"
        f" {100.0 * lost.mean():.0f}% packet loss\nround-trip min/avg/max = 1/2/3 ms\n", ms, lost,
    )  # fmt: skip
    return Made("hping.txt", content, "line", line(ms, lost, 1.0), {"period_s": "1.0"})


def mtr_raw(draw: np.random.Generator) -> Made:
    """Mtr --raw: x (sent) and p (answered, in microseconds) lines of several hops."""
    ms, lost = trips(draw)
    text = "h 0 192.168.1.1\nh 1 1.1.1.1\n"
    for n, (one, gone) in enumerate(zip(ms.tolist(), lost.tolist(), strict=True)):
        text += f"x 0 {2 * n}\nx 1 {2 * n + 1}\np 0 {draw.integers(500, 900)} {2 * n}\n"
        text += "" if gone else f"p 1 {round(1e3 * one)} {2 * n + 1}\n"
    return Made("mtr.txt", text.encode(), "line", line(ms, lost, 1.0))


def mtr_csv(draw: np.random.Generator) -> Made:
    """Mtr --csv: a row for each hop with averages, which is no log of messages."""
    names = "Mtr_Version,Start_Time,Status,Host,Hop,Ip,Loss%,Snt, ,Last,Avg,Best,Wrst,StDev,"
    text = names + "\n" + "".join(
        f"MTR.0.95,1760000000,OK,1.1.1.1,{n},10.0.{n}.1,0.00,100,0,{n}.1,{n}.2,{n}.0,{n}.9,0.1\n" for n in range(1, 12)
    )  # fmt: skip
    return Made("mtr.csv", text.encode(), "line", {})


def traceroute(draw: np.random.Generator) -> Made:
    """Traceroute: three times per hop, which is no log of messages."""
    text = "traceroute to 1.1.1.1 (1.1.1.1), 30 hops max, 60 byte packets\n" + "".join(
        f" {n}  10.0.{n}.1 (10.0.{n}.1)  {n}.123 ms  {n}.456 ms  {n}.789 ms\n" for n in range(1, 20)
    )
    return Made("traceroute.txt", text.encode(), "line", {})


def iperf_udp(draw: np.random.Generator) -> Made:
    """Iperf3 over UDP: jitter and losses of each second, and no delay of a message."""
    text = "[ ID] Interval           Transfer     Bitrate         Jitter    Lost/Total Datagrams\n" + "".join(
        f"[  5] {n:5.2f}-{n + 1:5.2f}  sec   128 KBytes  1.05 Mbits/sec  {0.1 + 0.01 * (n % 7):.3f} ms  0/91 (0%)\n"
        for n in range(400)
    )
    return Made("iperf.txt", text.encode(), "line", {})


def starlink(draw: np.random.Generator) -> Made:
    """A sheet of a dish: a date, a drop rate, and the round trip to its station each second."""
    ms, _ = trips(draw)
    lost = np.zeros(len(ms), dtype=bool)
    text = "datetimestamp_utc,pop_ping_drop_rate,pop_ping_latency_ms\n" + "".join(
        f"2026-01-02T03:{n // 60:02d}:{n % 60:02d}+00:00,0.0,{one:.3f}\n" for n, one in enumerate(ms.tolist())
    )
    return Made("starlink.csv", text.encode(), "line", line(ms, lost, 1.0), {"period_s": "1.0"})


def irtt_table(draw: np.random.Generator) -> Made:
    """A sheet of irtt's round trips: nanoseconds since an epoch, and a column for losses."""
    ms, lost = trips(draw)
    text = "seqno,send_wall_ns,rtt_ns,lost\n" + "".join(
        f"{n},{1_760_000_000_000_000_000 + 100_000_000 * n},{'' if gone else round(1e6 * one)},{int(gone)}\n"
        for n, (one, gone) in enumerate(zip(ms.tolist(), lost.tolist(), strict=True))
    )
    return Made("irtt.csv", text.encode(), "line", line(ms, lost, 0.1))


def one_way(draw: np.random.Generator) -> Made:
    """A sheet of one-way delays with German words for sent and received, in seconds with decimal commas."""
    ms, lost = trips(draw)
    text = "gesendet [s];empfangen [s]\n" + "".join(
        f"{0.1 * n:.4f};{'' if gone else f'{0.1 * n + 1e-3 * one:.4f}'}\n".replace(".", ",")
        for n, (one, gone) in enumerate(zip(ms.tolist(), lost.tolist(), strict=True))
    )
    return Made("strecke.csv", text.encode(), "line", line(ms, lost, 0.1, is_trip=False))


def dated_ping(draw: np.random.Generator) -> Made:
    """A shell loop that puts a date before each line of ping, with time-outs in another language."""
    ms, lost = trips(draw)

    def each(n: int, one: float, gone: bool) -> str:
        stamp = f"[2026-03-04 05:{n // 120:02d}:{0.5 * (n % 120) + (0.0 if gone else 1e-3 * one):06.3f}]"
        return f"{stamp} нет ответа: icmp_seq={n + 1}" if gone else (
            f"{stamp} 64 байт от 1.1.1.1: icmp_seq={n + 1} ttl=57 время={one:.1f} мс"
        )  # fmt: skip

    return Made("dated.txt", _pinged(each, "PING 1.1.1.1 (1.1.1.1)", "", ms, lost), "line", line(ms, lost, 0.5))


KINDS: tuple[Callable[[np.random.Generator], Made], ...] = (
    jpk_export, nanoscope_export, igor_text, park_export, german_semicolons, french_table, utf16_table, two_heads,
    deflection_by_stiffness, unit_row_at_the_end, zurich, sr760, analyser_dbm, hp35670, asylum_thermal, transposed,
    magnitude_and_phase, hard_curve, macos_ping, ping6_dated, german_windows, french_linux, hping, mtr_raw, mtr_csv,
    traceroute, iperf_udp, starlink, irtt_table, one_way, dated_ping,
)  # fmt: skip

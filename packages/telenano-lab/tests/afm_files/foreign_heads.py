"""Force curves below text heads of many kinds, with columns of many roles, and how often they are read right.

    python packages/telenano-lab/tests/afm_files/foreign_heads.py [COUNT] [--first SEED] [--kind NAME ...]

A curve has a contact, an adhesion on each way, and noise; it is written below a head that is drawn: numbers, dates,
units, tabs and words of two languages, in the layouts of the world's programs, with columns of other things beside it.
The reader sees the file, the spring constant and the sensitivity. For each kind the table has: read, refused, and
wrong: a greatest force, a pull-off of either way or a span of the height that is more than 5 % off.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from telenano.analysis import wilson
from telenano.testing import print_table

Array = np.ndarray
K, M_PER_V = 0.5, 50e-9


class Curve(NamedTuple):
    """Heights [m] of the approach, from far to near, its forces [N] and those of the retraction at the same heights."""

    height: Array
    there: Array
    back: Array
    draw: np.random.Generator

    @property
    def z(self) -> Array:
        return np.concatenate([self.height, self.height[::-1]])

    @property
    def force(self) -> Array:
        return np.concatenate([self.there, self.back[::-1]])

    @property
    def truth(self) -> dict[str, float]:
        return {"greatest": float(max(self.there.max(), self.back.max())), "pull_there": float(self.there.min()),
                "pull_back": float(self.back.min()), "span": float(np.ptp(self.height))}  # fmt: skip


def curve_of(draw: np.random.Generator, adhesion: bool | None = None, free_m: float | None = None) -> Curve:
    deep = draw.uniform(30e-9, 90e-9)
    height = np.linspace(
        free_m if free_m is not None else draw.uniform(150e-9, 300e-9), -deep, int(draw.integers(150, 500))
    )
    pull = draw.uniform(4e-9, 20e-9) if (draw.random() < 0.6 if adhesion is None else adhesion) else 0.0
    noise = 0.02e-9 * draw.standard_normal((2, len(height)))

    def of(pull_n: float) -> Array:
        return np.where(height < 0.0, -K * height, 0.0) - pull_n * np.exp(-np.abs(height) / 5e-9)

    return Curve(height, of(0.25 * pull) + noise[0], of(pull) + noise[1], draw)


UNITS = (("nm", 1e9), ("um", 1e6), ("µm", 1e6), ("m", 1.0), ("Å", 1e10))
VALUES = (("nN", 1e9), ("pN", 1e12), ("N", 1.0))
VOLTS = (("V", 1.0 / (K * M_PER_V)), ("mV", 1e3 / (K * M_PER_V)))
HEIGHTS = (
    "z",
    "Z",
    "Height",
    "height (measured)",
    "Piezo",
    "Z sensor",
    "Höhe",
    "Hauteur",
    "Altura",
    "Altezza",
    "Zsnsr",
    "Piezo position",
    "Weg",
    "高度",
    "Высота",
)
FORCES = ("Force", "force", "Vertical force", "Kraft", "Fuerza", "Forza", "F", "Normal force", "力", "Сила")
DEFLECTIONS = (
    "Deflection",
    "Vertical deflection",
    "Defl",
    "vDeflection",
    "Vertical",
    "Auslenkung",
    "Déflexion",
    "Deflexión",
    "Verbiegung",
    "Normal signal",
    "A-B",
)
OTHERS = (
    ("Lateral", "V"),
    ("Friction", "V"),
    ("hDeflection", "V"),
    ("Torsion", "mV"),
    ("Lateral deflection", "V"),
    ("Reibung", "V"),
    ("Frottement", "V"),
    ("Horizontal", "V"),
    ("Amplitude", "V"),
    ("Sum", "V"),
    ("Fricción", "V"),
    ("Amplitude", "nm"),
    ("Lateral force", "nN"),
)


def rows(columns: tuple[Array, ...], separator: str = "\t", mark: str = ".", end: str = "\n") -> str:
    return "".join(
        separator.join(f"{v:.7e}" for v in row).replace(".", mark) + end for row in zip(*columns, strict=True)
    )


class Columns(NamedTuple):
    """Names and units as a head has them, and the values."""

    names: list[str]
    units: list[str]
    values: list[Array]


def columns_of(curve: Curve, with_others: bool = False, volts: bool | None = None) -> Columns:
    """Draw names, units and signs of the two columns, with others of the same units before or behind them."""
    draw = curve.draw
    unit, scale = UNITS[draw.integers(len(UNITS))]
    if volts if volts is not None else draw.random() < 0.4:
        of_value, factor = VOLTS[draw.integers(len(VOLTS))]
        name = str(draw.choice(DEFLECTIONS))
    else:
        of_value, factor = VALUES[draw.integers(len(VALUES))]
        name = str(draw.choice(FORCES))
    z = scale * (draw.choice([-1.0, 1.0]) * curve.z + draw.choice([0.0, draw.uniform(-1e-6, 1e-6)]))
    value = factor * draw.choice([-1.0, 1.0]) * curve.force
    found = Columns([str(draw.choice(HEIGHTS)), name], [unit, of_value], [z, value])
    if with_others:
        for _ in range(int(draw.integers(1, 4))):
            other, unit = OTHERS[draw.integers(len(OTHERS))]
            if other not in found.names:
                place = int(draw.integers(0, len(found.names) + 1))
                found.names.insert(place, other)
                found.units.insert(place, unit)
                found.values.insert(place, draw.uniform(0.01, 3.0) * np.cumsum(draw.standard_normal(len(z))) / 20.0)
    return found


def titles(found: Columns, separator: str, form: str = "{} [{}]") -> str:
    return separator.join(form.format(*pair) for pair in zip(found.names, found.units, strict=True))


def facts(draw: np.random.Generator, mark: str = ".") -> list[str]:
    """Return lines that heads have: dates, times, counts, numbers with units, two languages."""
    kinds = (
        f"Date\t{draw.integers(1, 29)}.{draw.integers(1, 13)}.2026 {draw.integers(24)}:{draw.integers(10, 60)}:07",
        f"Datum: 2026-{draw.integers(10, 13)}-{draw.integers(10, 29)}", f"Points: {draw.integers(100, 5000)}",
        f"Federkonstante [N/m]: {draw.uniform(0.01, 40):.3f}".replace(".", mark), "Operator: A. Müller",
        f"Spring constant\t{draw.uniform(0.01, 40):.4f} N/m".replace(".", mark), "Constante de raideur : 0,35 N/m",
        f"Scan rate {draw.uniform(0.1, 10):.2f} Hz".replace(".", mark), "Sensitivity: 50 nm/V",
        f"X Offset: {draw.uniform(-5, 5):.3f} um".replace(".", mark), "Commentaire : échantillon de mica",
        "Tip = PNP-TR",
        f"Setpoint [V]\t{draw.uniform(0.1, 5):.3f}".replace(".", mark), "Mode: contact", "Version 1.4.2.20",
    )  # fmt: skip
    return [str(kinds[n]) for n in draw.permutation(len(kinds))[: draw.integers(3, 10)]]


def numbers(draw: np.random.Generator, width: int, mark: str = ".", separator: str = "\t") -> list[str]:
    """Return a few lines of numbers alone, as heads have them."""
    count = int(draw.integers(1, 7))
    return [
        separator.join(f"{v:.6e}" for v in draw.uniform(-1e-7, 1e-7, width)).replace(".", mark) for _ in range(count)
    ]


def plain(draw: np.random.Generator) -> tuple[str, Curve]:
    """Facts, and a line of titles."""
    curve = curve_of(draw)
    found = columns_of(curve)
    return "\n".join([*facts(draw), titles(found, "\t"), rows(tuple(found.values))]), curve


def data_mark(draw: np.random.Generator) -> tuple[str, Curve]:
    """Facts and lines of numbers, then [DATA], titles and the table, as Nanonis has them for other signals."""
    curve = curve_of(draw)
    found = columns_of(curve)
    head = [*facts(draw), "MultiLine Settings", *numbers(draw, int(draw.choice([2, 4, 5]))), ""]
    return "\n".join(
        [*head, draw.choice(["[Data]", "[DATA]", "[data]"]), titles(found, "\t", "{} ({})"), rows(tuple(found.values))]
    ), curve


def file_list_end(draw: np.random.Generator) -> tuple[str, Curve]:
    """A head of NanoScope: lines with a backslash, *File list end, titles with the unit behind a low line."""
    curve = curve_of(draw)
    lines = ["\\*Force file list", "\\Version: 0x09300103", f"\\Samps/line: {len(curve.height)} {len(curve.height)}",
             "\\Date: 04:30:25 PM Thu Nov 26 2026", "\\@Sens. Zsens: V 15.2 nm/V"]  # fmt: skip
    lines += numbers(draw, 2) if draw.random() < 0.5 else []
    name, factor = (("Force_nN", 1e9), ("Force_pN", 1e12), ("Defl_V", 1.0 / (K * M_PER_V)))[draw.integers(3)]
    sign = draw.choice([-1.0, 1.0])
    text = "\n".join(
        [*lines, "\\*File list end", f"Height_Sensor_nm\t{name}", rows((1e9 * sign * curve.z, factor * curve.force))]
    )
    return text, curve


def columns_line(draw: np.random.Generator) -> tuple[str, Curve]:
    """`columns:` and `units:` in comments, as JPK's export has them, with segments."""
    curve = curve_of(draw)
    sign = draw.choice([-1.0, 1.0])
    text = "# date: 2026-11-28 10:20\n# springConstant: 0.5\n"
    text += "\n".join(numbers(draw, 2, separator=" ")) + "\n\n" if draw.random() < 0.4 else ""
    for name, z, f in (("extend", curve.height, curve.there), ("retract", curve.height[::-1], curve.back[::-1])):
        text += f"#\n# segment: {name}\n# columns: height vDeflection hDeflection\n# units: m N N\n"
        text += rows((sign * z, f, 0.1e-9 * draw.standard_normal(len(z))), " ")
    return text, curve


def blank_line(draw: np.random.Generator) -> tuple[str, Curve]:
    """Lines of numbers in the head, then a blank line, then titles or none between."""
    curve = curve_of(draw)
    found = columns_of(curve)
    head = [*facts(draw), *numbers(draw, int(draw.choice([1, 2, 3]))), ""]
    return "\n".join([*head, titles(found, "\t"), rows(tuple(found.values))]), curve


def count_of_lines(draw: np.random.Generator) -> tuple[str, Curve]:
    """A count of the rows in the head, titles above lines of the settings of the same width."""
    curve = curve_of(draw)
    found = columns_of(curve)
    word = draw.choice(["Points", "Number of points", "Anzahl Punkte", "Nombre de points", "Data points"])
    head = [*facts(draw), f"{word}: {len(curve.z)}", titles(found, "\t")]
    return "\n".join([*head, *numbers(draw, 2), "", rows(tuple(found.values))]), curve


def labview(draw: np.random.Generator) -> tuple[str, Curve]:
    """A LabVIEW measurement: two ends of a head, X_Value and comments, decimal commas or points."""
    curve = curve_of(draw)
    found = columns_of(curve)
    mark = str(draw.choice([".", ","]))
    head = ["LabVIEW Measurement", "Writer_Version\t2", f"Decimal_Separator\t{mark}", "Date\t2026/11/28",
            "Time\t10:20:30,1234567", "***End_of_Header***", "", f"Channels\t{len(found.names)}",
            f"Samples\t{len(curve.z)}\t{len(curve.z)}", "***End_of_Header***"]  # fmt: skip
    return "\n".join([*head, titles(found, "\t"), rows(tuple(found.values), "\t", mark)]), curve


def spip(draw: np.random.Generator) -> tuple[str, Curve]:
    """`# key = value` and a block of numbers in comments and without them."""
    curve = curve_of(draw)
    found = columns_of(curve)
    head = ["# File Format = ASCII", "# Created 11/28/2026 10:20", f"# x-pixels = {len(curve.z)}", "#", "# Calibration",
            *numbers(draw, 1), *numbers(draw, 3), "#", "# Start of Data:", f"# {titles(found, chr(9))}"]  # fmt: skip
    return "\n".join([*head, rows(tuple(found.values))]), curve


def german(draw: np.random.Generator) -> tuple[str, Curve]:
    """German words, decimal commas, semicolons, a line of units below the names."""
    curve = curve_of(draw)
    unit, scale = UNITS[draw.integers(len(UNITS))]
    value, of_value, factor = (
        ("Kraft", "nN", 1e9),
        ("Auslenkung", "V", 1.0 / (K * M_PER_V)),
        ("Normalkraft", "nN", 1e9),
    )[draw.integers(3)]
    head = [
        "Messung vom 28.11.2026;10:20:30",
        f"Punkte;{len(curve.z)}",
        "Federkonstante;0,5;N/m",
        *numbers(draw, 2, ",", ";"),
        "",
    ]
    way = draw.choice(["Höhe", "Piezo", "Weg", "z-Position"])
    other = draw.choice(["Reibung", "Lateralkraft", "Torsion"])
    names = f"{way};{other};{value}\n{unit};V;{of_value}"
    columns = (
        scale * curve.z,
        0.1 * draw.standard_normal(len(curve.z)),
        draw.choice([-1.0, 1.0]) * factor * curve.force,
    )
    return "\n".join([*head, names, rows(columns, ";", ",")]), curve


def french(draw: np.random.Generator) -> tuple[str, Curve]:
    """French words, decimal commas, tabs."""
    curve = curve_of(draw)
    head = ["Courbe de force", "Échantillon : mica", "Raideur : 0,5 N/m", "28/11/2026", ""]
    way = draw.choice(["Hauteur", "Piézo", "Position z"])
    other = draw.choice(["Frottement", "Force latérale"])
    names = f"{way} (nm)\t{other} (nN)\t{draw.choice(['Force', 'Force normale', 'Force verticale'])} (nN)"
    columns = (1e9 * draw.choice([-1.0, 1.0]) * curve.z, draw.standard_normal(len(curve.z)), 1e9 * curve.force)
    return "\n".join([*head, names, rows(columns, "\t", ",")]), curve


def other_columns(draw: np.random.Generator) -> tuple[str, Curve]:
    """Lateral, friction, torsion, amplitude and sum signals of the same units before or behind the vertical one."""
    curve = curve_of(draw)
    found = columns_of(curve, with_others=True)
    return "\n".join([*facts(draw), titles(found, "\t"), rows(tuple(found.values))]), curve


def piezo_in_volts(draw: np.random.Generator) -> tuple[str, Curve]:
    """A piezo in volts beside a height in metres, or alone, where the deflection in nanometres is no height."""
    curve = curve_of(draw)
    piezo = curve.z / draw.uniform(5e-9, 50e-9)
    if draw.random() < 0.5:
        return f"Piezo [V]\tdeflection [nm]\n{rows((piezo, 1e9 * curve.force / K))}", curve
    return f"Piezo [V]\tHeight [nm]\tDeflection [V]\n{rows((piezo, 1e9 * curve.z, curve.force / K / M_PER_V))}", curve


def separation(draw: np.random.Generator) -> tuple[str, Curve]:
    """A separation of tip and sample, beside a height or alone: alone it is no height of the base."""
    curve = curve_of(draw)
    name = draw.choice(
        [
            "separation",
            "Tip-sample separation",
            "tip-sample distance",
            "Separación",
            "Abstand Spitze-Probe",
            "Séparation",
            "TSS",
        ]
    )
    apart = 1e9 * (curve.z + curve.force / K)
    if draw.random() < 0.5:
        return f"{name} [nm]\tForce [nN]\n{rows((apart, 1e9 * curve.force))}", curve
    return f"{name} [nm]\tz [nm]\tForce [nN]\n{rows((apart, 1e9 * curve.z, 1e9 * curve.force))}", curve


def no_free_part(draw: np.random.Generator) -> tuple[str, Curve]:
    """A curve that begins a few nanometres above the sample, with an offset of the force."""
    curve = curve_of(draw, adhesion=True, free_m=draw.uniform(2e-9, 15e-9))
    offset = draw.uniform(-20e-9, 40e-9)
    found = columns_of(curve._replace(there=curve.there + offset, back=curve.back + offset), volts=False)
    return f"{titles(found, chr(9))}\n{rows(tuple(found.values))}", curve


def offset(draw: np.random.Generator) -> tuple[str, Curve]:
    """An offset of the force, with a free part and adhesion or none."""
    curve = curve_of(draw)
    shift = draw.uniform(-50e-9, 50e-9)
    found = columns_of(curve._replace(there=curve.there + shift, back=curve.back + shift))
    return f"{titles(found, chr(9))}\n{rows(tuple(found.values))}", curve


def retract_first(draw: np.random.Generator) -> tuple[str, Curve]:
    """The retraction before the approach."""
    curve = curve_of(draw)
    unit, scale = UNITS[draw.integers(len(UNITS))]
    z = np.concatenate([curve.height[::-1], curve.height])
    force = np.concatenate([curve.back[::-1], curve.there])
    columns = (draw.choice([-1.0, 1.0]) * scale * z, draw.choice([-1.0, 1.0]) * 1e9 * force)
    return f"z [{unit}]\tForce [nN]\n{rows(columns)}", curve


def with_a_pause(draw: np.random.Generator) -> tuple[str, Curve]:
    """A pause at the turn, with a force that relaxes, and one in free air before the approach."""
    curve = curve_of(draw)
    count = int(draw.integers(20, 200))
    rest = curve.there[-1] * (1.0 - draw.uniform(0.02, 0.2) * (1.0 - np.exp(-np.linspace(0.0, 3.0, count))))
    z = np.concatenate(
        [np.full(count, curve.height[0]), curve.height, np.full(count, curve.height[-1]), curve.height[::-1]]
    )
    force = np.concatenate([np.zeros(count), curve.there, rest, curve.back[::-1]])
    force[:count] += 0.02e-9 * draw.standard_normal(count)
    sign, turned = draw.choice([-1.0, 1.0], 2)
    return f"z [nm]\tForce [nN]\n{rows((sign * 1e9 * z, turned * 1e9 * force))}", curve


def saturated(draw: np.random.Generator) -> tuple[str, Curve]:
    """A detector that ends below the greatest force: what was pressed is not in the file."""
    curve = curve_of(draw)
    most = draw.uniform(0.4, 0.8) * float(curve.there.max())
    force = np.minimum(curve.force, most)
    sign = draw.choice([-1.0, 1.0])
    return f"z [nm]\tDeflection [V]\n{rows((1e9 * curve.z, sign * force / K / M_PER_V))}", curve


def two_values(draw: np.random.Generator) -> tuple[str, Curve]:
    """Two deflections that no name tells apart: which one is meant, a person has to say."""
    curve = curve_of(draw)
    other = curve.force * draw.uniform(0.3, 0.8) + 1e-9 * np.cumsum(draw.standard_normal(len(curve.z))) / 5.0
    names = [
        ("Deflection 1", "Deflection 2"),
        ("Ch1", "Ch2"),
        ("Deflection A", "Deflection B"),
        ("Force 1", "Force 2"),
    ][draw.integers(4)]
    unit, factor = ("nN", 1e9) if names[0].startswith("Force") else ("V", 1.0 / (K * M_PER_V))
    columns = (1e9 * curve.z, factor * other, factor * curve.force)
    return f"z [nm]\t{names[0]} [{unit}]\t{names[1]} [{unit}]\n{rows(columns)}", curve


Kind = Callable[[np.random.Generator], tuple[str, Curve]]
KINDS: tuple[Kind, ...] = (
    plain, data_mark, file_list_end, columns_line, blank_line, count_of_lines, labview, spip, german, french,
    other_columns, piezo_in_volts, separation, no_free_part, offset, retract_first, with_a_pause, saturated, two_values,
)  # fmt: skip
# kinds of which what was measured is not in the file, or not said
UNKNOWN = (saturated, two_values)
# kinds in half of whose files there is no height of the base: they have to be refused
HALF_KNOWN = (piezo_in_volts, separation)


class Outcome(NamedTuple):
    """Of one file: what was wrong, empty where it was right; why it was refused, or what was said of it."""

    wrong: str
    reason: str = ""
    said: tuple[str, ...] = ()


def outcome(kind: Kind, seed: int, folder: Path) -> Outcome:
    """Write a file of a kind and return what the reader makes of it."""
    from telenano_lab.afm_files.curve_files import load_one

    from telenano.wire import ConfigError

    text, curve = kind(np.random.default_rng([KINDS.index(kind), seed]))
    path = folder / "curve.txt"
    path.write_text(text, encoding="utf-8")
    try:
        facts, (base, deflection) = load_one(str(path), "0", repr(K), repr(M_PER_V))
    except (ConfigError, ValueError) as error:
        return Outcome("", str(error))
    force = K * deflection
    # an offset is taken off by whoever uses the curve
    force = force - (np.median(force[np.argsort(base)[: len(base) // 10]]) if kind is not no_free_part else 0.0)
    approach, back = np.split(force, [facts["turn"]])
    truth, said = curve.truth, tuple(facts.get("remarks", ()))
    found = {"greatest": force.max(), "pull_there": approach.min(), "pull_back": back.min(), "span": np.ptp(base)}
    scale = truth["greatest"]
    if kind is no_free_part:
        # Only differences are known where nothing tells the offset.
        found = {"span": found["span"], "greatest": np.ptp(back)}
        truth = {"span": truth["span"], "greatest": float(np.ptp(curve.back))}
    # which end is the sample, and the sign, show in the course of the approach
    course = np.interp(np.linspace(0.0, 1.0, 200), np.linspace(0.0, 1.0, len(approach)), approach)
    true = np.interp(np.linspace(0.0, 1.0, 200), np.linspace(0.0, 1.0, len(curve.there)), curve.there)
    if kind is no_free_part and np.corrcoef(course, true)[0, 1] < 0.9:
        return Outcome("orientation", "", said)
    limits = {"span": 0.02 * truth["span"]}
    off = {
        name: found[name] - truth[name]
        for name in found
        if abs(found[name] - truth[name]) > limits.get(name, 0.05 * scale)
    }
    return Outcome(", ".join(f"{name} {value:+.2g}" for name, value in off.items()), "", said)


def main() -> None:
    """Print the table, and how many files were read wrongly without a word."""

    def is_told(one: Outcome) -> bool:
        return any("guess" in word or "extreme" in word for word in one.said)

    def is_silent(one: Outcome) -> bool:
        return bool(one.wrong) and not is_told(one)

    made = print_table(
        __doc__,
        KINDS,
        outcome,
        {
            "read": lambda found: sum(not one.reason for one in found),
            "refused": lambda found: sum(bool(one.reason) for one in found),
            "wrong, nothing said": lambda found: sum(map(is_silent, found)),
            "wrong, said to be guessed or saturated": lambda found: sum(
                bool(one.wrong) and is_told(one) for one in found
            ),
        },
        reason=lambda one: one.reason,
        fault=lambda one: f"{one.wrong} {one.said}" if one.wrong else "",
        note=lambda kind: (
            " (not determined)" if kind in UNKNOWN else " (half determined)" if kind in HALF_KNOWN else ""
        ),
    )
    found = [one for ones in made.values() for one in ones]
    wrong = sum(map(is_silent, found))
    low, high = wilson(wrong, len(found))
    sys.stdout.write(f"{wrong} of {len(found)} wrong without a word ({low:.2%} to {high:.2%})\n")


if __name__ == "__main__":
    main()

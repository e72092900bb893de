"""Files of other makers and lines of other kinds are read right or refused, and no reader takes those of another."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.afm_files.curve_files import load_one
from telenano_lab.afm_files.inspect_command import inspected
from telenano_lab.calibration.own_calibration import curve_of, sensitivity_of_curve, spectrum_of
from telenano_lab.networks.line_log import read_log

from telenano.wire.errors import TelenanoError
from tests.doubles.foreign_files import K_N_PER_M, KINDS, M_PER_V, Made

SEEDS = 3
REFUSALS = (TelenanoError, ValueError)
# Kinds that are refused, with what the refusal names: what no reader takes, and what a person has to give first.
REFUSED = {
    "igor_text": "is not a line of numbers", "unit_row_at_the_end": "is not a line of numbers",
    "analyser_dbm": "of a milliwatt in a resistance", "transposed": "no line of numbers",
    "mtr_raw": "no line of numbers", "mtr_csv": "no line of numbers", "traceroute": "no line of numbers",
    "iperf_udp": "no line of numbers", "one_way": "has the columns gesendet", "macos_ping": "--period",
    "hping": "--period", "starlink": "--period",
}  # fmt: skip
# Of all kinds this share is refused at first, and this share once the person has given what is asked for.
REFUSED_AT_FIRST, REFUSED_IN_THE_END = 12 / 31, 9 / 31


def as_curve(path: Path, asked: Mapping[str, str]) -> dict[str, float]:
    _, (base, deflection) = load_one(
        str(path), "0", repr(K_N_PER_M), repr(M_PER_V), json.dumps(dict(asked)) if asked else None
    )
    force = K_N_PER_M * deflection
    return {"pull_off_n": force.min(), "greatest_n": force.max(), "span_m": np.ptp(base)}


def as_spectrum(path: Path, asked: Mapping[str, str]) -> dict[str, float]:
    found = spectrum_of(path, **asked)
    lines = found.frequency_hz
    return {"first_hz": lines[0], "last_hz": lines[-1], "peak": found.density_per_hz.max()}


def as_sensitivity(path: Path, asked: Mapping[str, str]) -> dict[str, float]:
    way, volts, _ = curve_of(path, **asked)
    return {"nm_per_v": 1e9 * sensitivity_of_curve(way, volts).m_per_v}


def as_line(path: Path, asked: Mapping[str, str]) -> dict[str, float]:
    log = read_log([path], **{name: float(value) for name, value in asked.items()})
    delays = np.concatenate([part.delay_s for part in log.segments])
    lost = float(np.isnan(delays).sum())
    return {"count": len(delays), "lost": lost, "median_s": float(np.nanmedian(delays)), "period_s": log.period_s,
            "is_trip": float(log.round_trip)}  # fmt: skip


READERS: dict[str, Callable[[Path, Mapping[str, str]], dict[str, float]]] = {
    "curve": as_curve, "spectrum": as_spectrum, "sensitivity": as_sensitivity, "line": as_line,
}  # fmt: skip


def written(kind: Callable[[np.random.Generator], Made], seed: int, folder: Path) -> tuple[Made, Path]:
    made = kind(np.random.default_rng([KINDS.index(kind), seed]))
    path = folder / made.name
    path.write_bytes(made.content)
    return made, path


@pytest.mark.filterwarnings("ignore:Input line")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_foreign_file_is_read_right_or_refused_with_the_reason(
    kind: Callable[[np.random.Generator], Made], tmp_path: Path
) -> None:
    for seed in range(SEEDS):
        made, path = written(kind, seed, tmp_path)
        read = READERS[made.what]
        if kind.__name__ in REFUSED:
            with pytest.raises(REFUSALS, match=REFUSED[kind.__name__]):
                read(path, {})
            if not made.asked or "line of numbers" in REFUSED[kind.__name__]:
                continue
        # a time that a mean of many gives is right to 2 %
        assert read(path, made.asked) == pytest.approx(made.truth, rel=0.02), (kind.__name__, seed)
        said = str(inspected(path))
        assert {"curve": "curve", "spectrum": "spectrum", "sensitivity": "sensitivity", "line": ""}[made.what] in said


@pytest.mark.filterwarnings("ignore:Input line")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_no_reader_takes_a_file_that_is_of_another_kind(
    kind: Callable[[np.random.Generator], Made], tmp_path: Path
) -> None:
    made, path = written(kind, 0, tmp_path)
    # a curve on a hard sample is a curve all the same
    alike = {"curve": {"sensitivity"}, "sensitivity": {"curve"}}.get(made.what, set())
    for name in READERS.keys() - {made.what} - alike:
        with pytest.raises(REFUSALS):
            READERS[name](path, {})


def test_the_shares_of_refusals_are_those_that_are_stated() -> None:
    names = {kind.__name__ for kind in KINDS}
    assert len(names) == len(KINDS) and set(REFUSED) <= names
    made = {kind.__name__: kind(np.random.default_rng(0)) for kind in KINDS}
    in_the_end = [name for name, text in REFUSED.items() if not made[name].asked or "line of numbers" in text]
    assert (len(REFUSED) / len(KINDS), len(in_the_end) / len(KINDS)) == (REFUSED_AT_FIRST, REFUSED_IN_THE_END)


@pytest.mark.parametrize("unit", ["V/sqrt(Hz)", "V^2/Hz", "pm/√Hz"])
def test_decibels_are_taken_for_no_density_whatever_unit_is_given(unit: str, tmp_path: Path) -> None:
    (kind,) = (one for one in KINDS if one.__name__ == "sr760")
    _, path = written(kind, 1, tmp_path)
    with pytest.raises(TelenanoError, match="decibels"):
        spectrum_of(path, unit)

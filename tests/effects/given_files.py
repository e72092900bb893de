"""The files that commands read in the table of options: recordings, logs, images, curves, spectra and a study."""

import json
import random
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy import constants
from telenano_lab.calibration.resonance import density
from telenano_lab.doubles.made_journals import demo
from telenano_lab.experiments.plans import find_experiment
from typer.testing import CliRunner

from telenano.cli.root import app
from telenano.recording import FileSettings, RecordingWriter
from telenano.settings import DEMO_RECORDING
from telenano.testing import EPOCH_NS, numbered
from telenano.wire import encode

ROOT = Path(__file__).parents[2]
NOW = "2026-11-01T00:00:00+00:00"
DEVICE = "0123456789abcdef"
HANDLE: dict[str, Any] = {
    "schema": 1, "device_id": DEVICE, "calibrated": NOW, "max_force_n": 10.0,
    "position": {"zero_raw": 0, "m_per_count": -1e-6, "standard_error_m_per_count": 2e-9},
    "force": {"zero_raw": 0, "n_per_count": 1e-3, "standard_error_n_per_count": 1e-5, "saturation_n": 20.0},
    "drive": {"n_per_count": 1e-3}, "servo": {"stiffness_n_per_m": 1e4},
}  # fmt: skip
STAGE: dict[str, Any] = {
    "schema": 1, "instrument": {"map": "t7", "serial": 470012345}, "calibrated": NOW, "network": {"host": "127.0.0.1"},
    "stage": {"m_per_v": 8e-8, "rest_v": 1.0, "min_v": 0.0, "max_v": 5.0, "slew_v_per_s": 1e3},
    "deflection": {"range_v": 10.0, "zero_v": 0.0, "v_per_m": -2e7, "standard_error_v_per_m": 6e5},
    "cantilever": {"stiffness_n_per_m": 40.0, "standard_error_n_per_m": 1.6},
}  # fmt: skip
EXPERIMENT: dict[str, Any] = {
    "name": "small", "title": "Two laws", "scenario": "fig12", "settings": {}, "seed": 1, "apparatus": "lockstep",
    "participants": 2, "operator": {"kind": "simulated"},
    "tasks": [{"name": "touch_and_hold", "parameters": {"force_n": 20e-9, "limit_s": 4.0}}],
    "factors": {"law": ["virtual_impedance"]}, "repetitions": 1, "order": "shuffle",
}  # fmt: skip
# The public key of a machine, as `telenano keys new` prints it.
KEY = "EN}gwgkd7fg5h5GZnj3X@U(8/WQo+rYEbto1PQs{"
RATE_HZ, RESONANCE_HZ, QUALITY, STIFFNESS_N_PER_M, M_PER_V = 1e6, 70e3, 180.0, 2.7, 60e-9


@cache
def given(folder: Path) -> dict[str, str]:
    """Make the files in a folder that is emptied at no time; return where each is, by its name in words of commands."""
    made = folder / "given"
    made.mkdir()
    recordings = {"raw": raw(made), **parts(made)}
    files = {
        "handle": written(made / "handle.yaml", HANDLE),
        "other_handle": written(made / "other.yaml", {**HANDLE, "position": {"zero_raw": 0, "m_per_count": -2e-6}}),
        "stage": written(made / "stage.yaml", STAGE),
        "experiment": written(made / "small.yaml", EXPERIMENT),
        "log": log(made),
        "image": image(made),
        "curve": ROOT / "examples" / "force_curve.txt",
        "flat": flat(made),
        "cone": cone(made),
        "hard": hard(made / "hard.txt", 60.0),
        "other_hard": hard(made / "other_hard.txt", 50.0),
        "spectrum": spectrum(made),
        "record": record(made),
        "study": study(made),
        "map": made / "map.npz",
        "again": made / "again.mcap",
        "done": made / "done",
        "elsewhere": made / "elsewhere",
    }
    telenano("sample", "import", files["curve"], "--set", "stiffness_n_per_m=2", "--out", files["map"])
    telenano("experiment", "run", files["experiment"], "--out", files["done"])
    telenano("bag", "recalibrate", recordings["raw"], "--handle", files["other_handle"], "--out", files["again"])
    return {name: str(path) for name, path in {**recordings, **files}.items()} | {"key": f"'{KEY}'"}


def telenano(*words: object) -> None:
    """Run a command that has to end well."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, f"{words}: {done.output}"


def written(path: Path, document: dict[str, Any]) -> Path:
    """Write a document as YAML."""
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return path


def parts(folder: Path) -> dict[str, Any]:
    """Split the demonstration; return its folder and its files."""
    out = folder / "parts"
    telenano("bag", "split", DEMO_RECORDING, "--out", out, "--interval", "2")
    return {"folder": out, "parts": " ".join(map(str, sorted(out.glob("*.mcap"))))}


def raw(folder: Path) -> Path:
    """Write a recording of both devices, in counts and volts beside what their calibrations make of them."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    counts = {"position_raw": 10, "velocity_raw": 5, "operator_force_raw": 7, "drive_raw": 3}
    device = {"device": "ok", "sample_age_s": 1e-3}
    rows: list[tuple[str, str, str, dict[str, Any]]] = [
        ("node/health", "haptic_node@master", "master", {"calibration": f"{DEVICE} {NOW}"}),
        ("node/health", "afm_node@slave", "slave", {"calibration": f"t7 470012345 {NOW}"}),
        ("haptic/state", "haptic_node@master", "master", {**device, **counts}),
        ("afm/state", "afm_node@slave", "slave", {**device, "output_v": 2.6, "input_v": 0.0123}),
    ]
    for seq, (topic, src, site, fields) in enumerate(rows):
        channel = writer.channel(topic, src, site)
        writer.write(
            channel, EPOCH_NS + seq * 1_000_000, EPOCH_NS, seq, encode(numbered(topic, seq, src=src, **fields))
        )
    writer.finish()
    return writer.path


def log(folder: Path) -> Path:
    """Write the log of a line that delays at random and loses some."""
    draw = random.Random(93)
    rows = [f"{10 * tick},{'' if draw.random() < 0.01 else 20.0 + draw.expovariate(0.3):.6}" for tick in range(6000)]
    path = folder / "log.csv"
    path.write_text("sent_ms,delay_ms\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def image(folder: Path) -> Path:
    """Write the heights of three spheres on a plane of 3 um."""
    y, x = np.mgrid[:96, :96] * (3000.0 / 96)
    heights = np.zeros_like(x)
    for x0, y0, radius in ((800, 800, 250), (2000, 1500, 250), (1200, 2300, 250)):
        rest = radius**2 - (x - x0) ** 2 - (y - y0) ** 2
        heights = np.maximum(heights, np.where(rest > 0.0, radius + np.sqrt(np.maximum(rest, 0.0)), 0.0))
    np.save(folder / "image.npy", heights * 1e-9)
    return folder / "image.npy"


def flat(folder: Path) -> Path:
    """Write a curve that never meets the sample, which no model fits."""
    draw = np.random.default_rng(2)
    rows = [
        f"{z:.2f}\t{force:.3f}" for z, force in zip(np.linspace(40, -20, 150), draw.normal(0, 0.05, 150), strict=True)
    ]
    path = folder / "flat.txt"
    path.write_text("z [nm]\tforce [nN]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def cone(folder: Path) -> Path:
    """Write a curve on a soft sample without adhesion, into which a cone goes, approach and retraction alike."""
    depth = np.maximum(np.linspace(-30.0, 25.0, 200), 0.0)
    force = 0.05 * depth**2
    way = 10.0 - np.linspace(-30.0, 25.0, 200) - force / 2.0
    noise = np.random.default_rng(5).normal(0.0, 0.05, 400)
    both = zip(np.concatenate([way, way[::-1]]), np.concatenate([force, force[::-1]]) + noise, strict=True)
    path = folder / "cone.txt"
    path.write_text("z [nm]\tforce [nN]\n" + "".join(f"{z:.3f}\t{f:.3f}\n" for z, f in both), encoding="utf-8")
    return path


def hard(path: Path, nm_per_v: float) -> Path:
    """Write a curve on a hard sample."""
    draw = np.random.default_rng(3)
    way = np.linspace(0.0, 200.0, 600)
    volt = np.where(way > 60.0, (way - 60.0) / nm_per_v, 0.0) + draw.normal(0.0, 2e-3, way.size)
    rows = [f"{one:.4f}\t{other:.6f}" for one, other in zip(way, volt, strict=True)]
    path.write_text("way [nm]\tdeflection [V]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def spectrum(folder: Path) -> Path:
    """Write the thermal spectrum of a lever in air, a mean of fifty."""
    frequency = np.linspace(0.0, 0.5 * RATE_HZ, 4001)[1:]
    mean_square = constants.k * 300.0 / STIFFNESS_N_PER_M
    mean = density(frequency, RATE_HZ, mean_square, RESONANCE_HZ, QUALITY) + (50e-15) ** 2
    found = mean * np.random.default_rng(1).gamma(50, 1 / 50, frequency.size) / M_PER_V**2
    path = folder / "spectrum.txt"
    rows = [f"{one:.6g}\t{other:.6e}" for one, other in zip(frequency, found, strict=True)]
    path.write_text("frequency [Hz]\tdensity [V^2/Hz]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def record(folder: Path) -> Path:
    """Write the free deflection of the same lever, a resonator that noise drives, above the noise of the read-out."""
    draw = np.random.default_rng(4)
    omega = 2.0 * np.pi * RESONANCE_HZ / RATE_HZ
    damping = np.exp(-omega / (2.0 * QUALITY))
    first, second = 2.0 * damping * np.cos(omega * np.sqrt(1.0 - 0.25 / QUALITY**2)), -(damping**2)
    noise = draw.normal(0.0, 1.0, 120_000)
    moved = np.zeros(noise.size)
    for n in range(2, noise.size):
        moved[n] = first * moved[n - 1] + second * moved[n - 2] + noise[n]
    moved = moved[20_000:]
    scale = np.sqrt(constants.k * 300.0 / STIFFNESS_N_PER_M) / M_PER_V / moved.std()
    path = folder / "record.txt"
    np.savetxt(path, moved * scale + draw.normal(0.0, 5e-4, moved.size), fmt="%.8e")
    return path


def study(folder: Path) -> Path:
    """Write the folder of an experiment that was run, with an effect of the delay."""
    out = folder / "study"
    out.mkdir()
    shutil.copy(find_experiment("delay_and_law"), out / "experiment.yaml")
    begun = {"record": "begun", "utc": "2026-11-22T09:00:00.000+00:00", "digest": "0123456789abcdef"}
    lines = [json.dumps(one) for one in (begun, *demo(2))]
    (out / "journal.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return out

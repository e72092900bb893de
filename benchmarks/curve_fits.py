"""Force curves fitted as `telenano curve fit` does and by nanite, in turn: the time of each, and whose errors hold.

    python benchmarks/curve_fits.py [CURVES = 512, of each of 8 lines]          needs: pip install nanite

The curves are those of a known sphere or cone, with noise that is white or wanders, tilt and drift. An interval is the
figure with 1.96 of its standard errors on both sides; nanite's are those of lmfit. Each line has a model and a kind of
noise.
"""

import math
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from telenano_lab.doubles.made_curves import NOISES, Made, drawn_curve
from telenano_lab.microscopy.curve_fit import ContactShape, MeasuredWays, fit_curve


def by_telenano(made: Made) -> tuple[float, float] | None:
    """Return the modulus [Pa] and its standard error, None where the curve is refused."""
    ways = MeasuredWays(
        made.approach_m, made.approach_n, made.retract_m, made.retract_n, made.stiffness_n_per_m
    )  # fmt: skip
    found = fit_curve(ways, ContactShape(made.model, made.radius_m, made.half_angle_rad, made.poisson))
    return None if found.refused else (found.modulus_pa, found.modulus_error_pa)


def by_nanite(made: Made) -> tuple[float, float] | None:
    """Return the modulus [Pa] and its standard error, None where nanite has none."""
    from nanite import Indentation

    data = {
        "force": np.concatenate([made.approach_n[::-1], made.retract_n]),
        "height (measured)": np.concatenate([made.approach_m[::-1], made.retract_m]),
        "segment": np.repeat(np.array([0, 1], np.uint8), len(made.approach_m)),
        "time": np.arange(2 * len(made.approach_m)) * 1e-3,
    }
    metadata = {
        "spring constant": made.stiffness_n_per_m, "imaging mode": "force-distance", "enum": 0, "path": Path("made.h5"),
        "point count": 2 * len(made.approach_m),
    }  # fmt: skip
    curve = Indentation(data, metadata)
    curve.apply_preprocessing(
        ["compute_tip_position", "correct_force_offset", "correct_tip_offset", "correct_force_slope"]
    )
    key = {"hertz": "hertz_para", "sneddon": "hertz_cone"}[made.model]
    given = curve.get_initial_fit_parameters(model_key=key)
    given["nu"].value = made.poisson
    if made.model == "hertz":
        given["R"].value = made.radius_m
    else:
        given["alpha"].value = math.degrees(made.half_angle_rad)
    # a softer or harder sample than a cell must not keep lmfit at its bound
    given["E"].set(value=made.truth.modulus_pa * 3.0, min=0.0, max=np.inf)
    curve.fit_model(model_key=key, params_initial=given, weight_cp=False)
    fitted = curve.fit_properties.get("params_fitted")
    if not curve.fit_properties.get("success") or fitted["E"].stderr is None:
        return None
    return float(fitted["E"].value), float(fitted["E"].stderr)


def compared(model: str, noise: str, count: int) -> tuple[str, dict[str, float]]:
    """Return a line of the table, and the seconds of both."""
    ways: dict[str, Any] = {"telenano": by_telenano, "nanite": by_nanite}
    seconds, held, fitted, off = dict.fromkeys(ways, 0.0), dict.fromkeys(ways, 0), dict.fromkeys(ways, 0), {}
    shares: dict[str, list[float]] = {name: [] for name in ways}
    for seed in range(count):
        made = drawn_curve(model, 10_000 + seed, noise=noise)
        for name, way in ways.items():
            begun = time.perf_counter()
            found = way(made)
            seconds[name] += time.perf_counter() - begun
            if found is not None:
                fitted[name] += 1
                held[name] += abs(found[0] - made.truth.modulus_pa) <= 1.96 * found[1]
                shares[name].append(abs(found[0] / made.truth.modulus_pa - 1.0))
    parts = []
    for name in ways:
        off[name] = 100.0 * float(np.median(shares[name])) if shares[name] else math.nan
        cover = 100.0 * held[name] / max(fitted[name], 1)
        milliseconds = 1e3 * seconds[name] / count
        parts.append(f"{fitted[name]:5d} {cover:6.0f} {off[name]:8.2g} {milliseconds:8.1f}")
    line = f"{model:8s} {noise:8s} " + "  ".join(parts) + f" {seconds['nanite'] / seconds['telenano']:8.1f}"
    return line, seconds


def main(count: int) -> None:
    """Print the table, and the time of all curves."""
    warnings.simplefilter("ignore")
    try:
        import nanite
    except ImportError:
        sys.exit("nanite is not installed: pip install nanite")
    for model in ("hertz", "sneddon"):
        by_telenano(drawn_curve(model, 0))
    print(f"nanite {nanite.__version__}; {count} curves a line")
    print("                  telenano: fitted, covers %, off %, ms   nanite: the same           nanite/telenano")
    both = {"telenano": 0.0, "nanite": 0.0}
    for model in ("hertz", "sneddon"):
        for noise in NOISES:
            line, seconds = compared(model, noise, count)
            print(line, flush=True)
            both = {name: both[name] + seconds[name] for name in both}
    print(f"{8 * count} curves: telenano {both['telenano']:.1f} s, nanite {both['nanite']:.1f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 512)

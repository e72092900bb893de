"""Force curves fitted as `telenano curve fit` does and by nanite, in turn: the time of each, and whose errors hold.

    python benchmarks/curve_fits.py [--curves 512] [--json]          needs: pip install nanite

The curves are those of a known sphere or cone, with white or wandering noise, tilt and drift. An interval is the
modulus plus and minus 1.96 standard errors; those of nanite are from lmfit. Each row has a model and a kind of noise.
"""

import argparse
import itertools
import json
import math
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from telenano_lab.doubles.made_curves import NOISES, MadeCurve, drawn_curve
from telenano_lab.microscopy.curve_fit import ContactShape, MeasuredWays, fit_curve

MODELS = ("hertz", "sneddon")


def by_telenano(made: MadeCurve) -> tuple[float, float] | None:
    """Return the modulus and its standard error [Pa], None if the fit refuses the curve."""
    ways = MeasuredWays(
        made.approach_m, made.approach_n, made.retract_m, made.retract_n, made.stiffness_n_per_m
    )  # fmt: skip
    found = fit_curve(ways, ContactShape(made.model, made.radius_m, made.half_angle_rad, made.poisson))
    return None if found.refused else (found.modulus_pa, found.modulus_error_pa)


def by_nanite(made: MadeCurve) -> tuple[float, float] | None:
    """Return the modulus and its standard error [Pa], None if nanite has none."""
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
    # Without new bounds, a sample softer or harder than a cell would keep lmfit at its bound.
    given["E"].set(value=made.truth.modulus_pa * 3.0, min=0.0, max=np.inf)
    curve.fit_model(model_key=key, params_initial=given, weight_cp=False)
    fitted = curve.fit_properties.get("params_fitted")
    if not curve.fit_properties.get("success") or fitted["E"].stderr is None:
        return None
    return float(fitted["E"].value), float(fitted["E"].stderr)


def compared(model: str, noise: str, count: int) -> dict[str, dict[str, float]]:
    """Return for both: number of fitted curves, coverage of the interval [%], error [%] and time [ms]."""
    ways: dict[str, Callable[[MadeCurve], tuple[float, float] | None]] = {"telenano": by_telenano, "nanite": by_nanite}
    seconds, held = dict.fromkeys(ways, 0.0), dict.fromkeys(ways, 0)
    shares: dict[str, list[float]] = {name: [] for name in ways}
    for seed in range(count):
        made = drawn_curve(model, 10_000 + seed, noise=noise)
        for name, way in ways.items():
            begun = time.perf_counter()
            found = way(made)
            seconds[name] += time.perf_counter() - begun
            if found is not None:
                held[name] += abs(found[0] - made.truth.modulus_pa) <= 1.96 * found[1]
                shares[name].append(abs(found[0] / made.truth.modulus_pa - 1.0))
    return {
        name: {
            "fitted": len(shares[name]),
            "covers_percent": 100.0 * held[name] / max(len(shares[name]), 1),
            "off_percent": 100.0 * float(np.median(shares[name])) if shares[name] else 0.0,
            "ms": 1e3 * seconds[name] / count,
        }
        for name in ways
    }


def main() -> None:
    """Print the table, and the total time for all curves."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--curves", type=int, default=512, help="curves of each of the eight lines")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    try:
        import nanite
    except ImportError:
        sys.exit("nanite is not installed: pip install nanite")
    count = 4 if given.smoke else given.curves
    for model in MODELS:
        by_telenano(drawn_curve(model, 0))
    if not given.json:
        print(f"nanite {nanite.__version__}; {count} curves a line")
        print("                  telenano: fitted, covers %, off %, ms   nanite: the same           nanite/telenano")
    rows = []
    for model, noise in itertools.product(MODELS, NOISES):
        found = compared(model, noise, count)
        rows.append({"model": model, "noise": noise, **found, "ratio": found["nanite"]["ms"] / found["telenano"]["ms"]})
        if not given.json:
            parts = [
                f"{one['fitted']:5.0f} {one['covers_percent']:6.0f} {one['off_percent']:8.2g} {one['ms']:8.1f}"
                for one in found.values()
            ]
            print(f"{model:8s} {noise:8s} {'  '.join(parts)} {rows[-1]['ratio']:8.1f}", flush=True)
    whole_s = {name: sum(1e-3 * count * row[name]["ms"] for row in rows) for name in ("telenano", "nanite")}
    if given.json:
        print(json.dumps({"rows": rows, "whole_s": whole_s}))
    else:
        print(f"{len(rows) * count} curves: telenano {whole_s['telenano']:.1f} s, nanite {whole_s['nanite']:.1f} s")


if __name__ == "__main__":
    main()

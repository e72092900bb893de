"""Fit your force curves: contact point, reduced modulus and adhesion of each, in a table and a picture.

Run it: python examples/fit_curves.py [FOLDER [RADIUS_NM [CURVE…]]]     takes: 2 s     needs: telenano[viz]
You see: the approach of each curve and the sphere on a half-space (Hertz) through it, from where it touches. A CURVE is
a text table of height [nm] and force [nN], the approach first; without one it is force_curve.txt, a soft sphere.
"""

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
RADIUS_M = 1e-9 * (float(sys.argv[2]) if len(sys.argv) > 2 else 30.0)
CURVES = [Path(name) for name in sys.argv[3:]] or [Path(__file__).with_name("force_curve.txt")]
STIFFNESS_N_PER_M = 2.0  # of the cantilever that measured them


def approach_of(path: Path) -> npt.NDArray[np.float64]:
    """Return height of the tip [m] and force [N] of the approach: the rows until the height turns."""
    height_nm, force_nn = np.loadtxt(path, skiprows=1, usecols=(0, 1)).T
    turn = int(np.argmin(height_nm)) + 1
    # the tip is nearer to the sample, or further away, by what the cantilever bends
    return 1e-9 * np.array([(height_nm + force_nn / STIFFNESS_N_PER_M)[:turn], force_nn[:turn]])


def fitted(height_m: npt.NDArray[np.float64], force_n: npt.NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return contact point [m], reduced modulus [Pa], its standard error and the rest of the fit [N].

    F = 4/3 E* sqrt(R) d^1.5 is linear in E* for a given contact point, which is found among all heights.
    """
    best = (np.inf, 0.0, 0.0, 0.0)
    for contact_m in np.linspace(height_m.min(), np.percentile(height_m, 60.0), 800):
        shape = 4.0 / 3.0 * np.sqrt(RADIUS_M) * np.clip(contact_m - height_m, 0.0, None) ** 1.5
        if np.count_nonzero(shape) < 5:
            continue
        modulus_pa = float(shape @ force_n / (shape @ shape))
        rest_n = float(np.std(force_n - modulus_pa * shape))
        best = min(best, (rest_n, float(contact_m), modulus_pa, rest_n / float(np.sqrt(shape @ shape))))
    rest_n, contact_m, modulus_pa, error_pa = best
    return contact_m, modulus_pa, error_pa, rest_n


OUT.mkdir(parents=True, exist_ok=True)
figure = Figure(figsize=(7.0, 3.8), layout="constrained")
axes = figure.subplots()
for path in CURVES:
    height_m, force_n = approach_of(path)
    contact_m, modulus_pa, error_pa, rest_n = fitted(height_m, force_n)
    print(f"{path.name} contact_nm {1e9 * contact_m:.2f} modulus_mpa {1e-6 * modulus_pa:.2f} "
          f"error_mpa {1e-6 * error_pa:.2f} rest_nn {1e9 * rest_n:.3f} least_nn {1e9 * force_n.min():.2f}")  # fmt: skip
    (line,) = axes.plot(1e9 * height_m, 1e9 * force_n, ".", ms=3, label=f"{path.name}: {1e-6 * modulus_pa:.1f} MPa")
    model = 4.0 / 3.0 * modulus_pa * np.sqrt(RADIUS_M) * np.clip(contact_m - height_m, 0.0, None) ** 1.5
    axes.plot(1e9 * height_m, 1e9 * model, "k-", lw=1.0)
axes.set(xlabel="height of the tip (nm)", ylabel="force at the tip (nN)")
axes.legend(frameon=False)
figure.savefig(OUT / "fit_curves.png", dpi=80)

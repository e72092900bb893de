"""Fit your force curves: contact point, reduced modulus and greatest pull of each, in lines and a picture.

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
Floats = npt.NDArray[np.float64]


def approach_of(path: Path) -> Floats:
    """Return height of the tip [m] and force [N] of the approach: the rows until the height turns."""
    height_nm, force_nn = np.loadtxt(path, skiprows=1, usecols=(0, 1)).T
    turn = int(np.argmin(height_nm)) + 1
    # the tip is nearer to the sample, or further away, by what the cantilever bends
    return 1e-9 * np.array([(height_nm + force_nn / STIFFNESS_N_PER_M)[:turn], force_nn[:turn]])


def sphere(height_m: Floats, contact_m: float) -> Floats:
    """Return the force of a sphere on a half-space of 1 Pa that it touches at a height [N]: 4/3 sqrt(R) d^1.5."""
    return np.asarray(4.0 / 3.0 * np.sqrt(RADIUS_M) * np.clip(contact_m - height_m, 0.0, None) ** 1.5)


def fitted(height_m: Floats, force_n: Floats) -> tuple[float, float, float, float]:
    """Return the rest of the best fit [N], its contact point [m], reduced modulus [Pa] and standard error of that."""
    best = (np.inf, 0.0, 0.0, 0.0)
    for contact_m in np.linspace(height_m.min(), np.percentile(height_m, 60.0), 800):
        shape = sphere(height_m, float(contact_m))
        if np.count_nonzero(shape) < 5:
            continue
        modulus_pa = float(shape @ force_n / (shape @ shape))
        rest_n = float(np.std(force_n - modulus_pa * shape))
        best = min(best, (rest_n, float(contact_m), modulus_pa, rest_n / float(np.sqrt(shape @ shape))))
    return best


OUT.mkdir(parents=True, exist_ok=True)
figure = Figure(figsize=(7.0, 3.8), layout="constrained")
axes = figure.subplots()
for path in CURVES:
    height_m, force_n = approach_of(path)
    rest_n, contact_m, modulus_pa, error_pa = fitted(height_m, force_n)
    print(f"{path.name} contact_nm {1e9 * contact_m:.2f} modulus_mpa {1e-6 * modulus_pa:.2f} "
          f"error_mpa {1e-6 * error_pa:.2f} rest_nn {1e9 * rest_n:.3f} least_nn {1e9 * force_n.min():.2f}")  # fmt: skip
    axes.plot(1e9 * height_m, 1e9 * force_n, ".", ms=3, label=f"{path.name}: {1e-6 * modulus_pa:.1f} MPa")
    axes.plot(1e9 * height_m, 1e9 * modulus_pa * sphere(height_m, contact_m), "k-", lw=1.0)
axes.set(xlabel="height of the tip (nm)", ylabel="force at the tip (nN)")
axes.legend(frameon=False)
figure.savefig(OUT / "fit_curves.png", dpi=80)

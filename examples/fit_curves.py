"""Fit your force curves: contact point, modulus and adhesion of each with their errors, in lines and a picture.

Run it: python examples/fit_curves.py [FOLDER [RADIUS_NM [FILE…]]]   takes: 5 s   needs: telenano[viz], telenano-lab
You see: three of the fits, with what they leave, and a line for each curve. A FILE is a curve, a map of curves or a
folder; without one it is force_curve.txt, a soft sphere. `telenano curve fit` does the same on the command line, and
`telenano.curves(FILES, "hertz", radius_m=…)` gives the table alone.
"""

import sys
from pathlib import Path

from telenano_lab.afm_files.curve_table import fit_files, frame_of
from telenano_lab.afm_files.curve_table_figure import fits_figure
from telenano_lab.microscopy.curve_fit import ContactShape

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples")
RADIUS_M = 1e-9 * (float(sys.argv[2]) if len(sys.argv) > 2 else 30.0)
FILES = [Path(name) for name in sys.argv[3:]] or [Path(__file__).with_name("force_curve.txt")]
LACKING = {"stiffness_n_per_m": 2.0}  # of the cantilever that measured force_curve.txt, which its head does not say

# With a Poisson ratio of 0 the modulus is the reduced one.
fitted = fit_files(FILES, ContactShape("hertz", radius_m=RADIUS_M, poisson=0.0), LACKING)
for row in frame_of(fitted, "hertz").itertuples():
    name = f"{Path(row.file).name} {row.curve}" if row.curve else Path(row.file).name
    if row.verdict == "refused":
        print(f"{name} refused: {row.reason}")
        continue
    print(f"{name} contact_nm {1e9 * row.contact_m:.2f} modulus_mpa {1e-6 * row.modulus_pa:.2f} "
          f"error_mpa {1e-6 * row.modulus_error_pa:.2f} adhesion_nn {1e9 * row.adhesion_n:.2f} "
          f"rest_nn {1e9 * row.residual_n:.3f}")  # fmt: skip

OUT.mkdir(parents=True, exist_ok=True)
if (figure := fits_figure(fitted)) is not None:
    figure.savefig(OUT / "fit_curves.png", dpi=80)

"""The amplitude-phase curve of a measured image in tapping mode, and the dissipated energy that follows from it.

A lagging feedback lets the amplitude vary about its set-point, so the pixels of an image are points of the
amplitude-phase curve. In a steady motion driven at its resonance (J. P. Cleveland and others, Appl. Phys. Lett. 72
(1998) 2613)

    sin(phi) = a + e / a,    a = A / A0,    e = Q E / (pi k A0^2),

where E is the energy that the sample dissipates in a period; phi = 90 degrees in free motion. The fit has an energy
that grows with the depth of the tip, e = c + d (1 - a); c and d may be 0.
"""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.files import atomic_file, read_in_child
from telenano.wire import ConfigError
from telenano_lab.afm_files.igor_waves import load_wave, notes_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

_WIDTH = 0.01
_LEAST_PIXELS = 20


class AmplitudePhase(NamedTuple):
    """Medians over bins of the amplitude a = A / A0, shape (n,): phase [degrees], its error, pixels; and the fit.

    constant, slope: c and d of e = c + d (1 - a), with standard errors; model_deg: the phase of the fit; still_deg:
    that of a sample that dissipates no energy. Neighbouring pixels are not independent, so the error of a phase assumes
    only as many pixels as the least populated bin may have.
    """

    amplitude: Array
    phase_deg: Array
    error_deg: Array
    pixels: Array
    constant: float
    constant_error: float
    slope: float
    slope_error: float
    model_deg: Array
    still_deg: Array


def amplitude_phase(amplitude_share: Array, phase_deg: Array) -> AmplitudePhase:
    """Bin pixels into an amplitude-phase curve and fit it; amplitude as a share of the free one, phase in degrees.

    Raises: ConfigError, if fewer than four bins of the amplitude have enough pixels.
    """
    from scipy.optimize import least_squares

    spans = np.floor(amplitude_share / _WIDTH).astype(int)
    rows = []
    for span in np.unique(spans[(amplitude_share > 0.0) & (amplitude_share < 1.0)]):
        phases_deg = phase_deg[spans == span]
        if phases_deg.size >= _LEAST_PIXELS:
            spread = 1.4826 * float(np.median(np.abs(phases_deg - np.median(phases_deg))))
            rows.append(
                (
                    (span + 0.5) * _WIDTH,
                    float(np.median(phases_deg)),
                    spread / math.sqrt(_LEAST_PIXELS),
                    phases_deg.size,
                )
            )
    if len(rows) < 4:
        raise ConfigError(f"the amplitude has {len(rows)} spans of {_LEAST_PIXELS} pixels; 4 are needed for a curve")
    a, phase, error, pixels = (np.array(column) for column in zip(*rows, strict=True))
    # Attraction keeps the phase above 90 degrees, repulsion below.
    side = 1.0 if float(np.median(phase)) > 90.0 else -1.0

    def model_deg(free: Array) -> Array:
        sine = a + (free[0] + free[1] * (1.0 - a)) / a
        return np.asarray(90.0 + side * np.degrees(np.arccos(np.clip(sine, -1.0, 1.0))))

    # The start lies inside, where the phase depends on both parameters.
    phases_deg = least_squares(lambda free: model_deg(free) - phase, [0.0, 0.1], diff_step=1e-4, x_scale=0.1)
    scatter_deg = math.sqrt(2.0 * float(phases_deg.cost) / (len(a) - 2))
    constant_error, slope_error = (
        scatter_deg * np.sqrt(np.diag(np.linalg.pinv(phases_deg.jac.T @ phases_deg.jac)))
    ).tolist()
    constant, slope = phases_deg.x.tolist()
    still_deg = model_deg(np.zeros(2))
    return AmplitudePhase(
        a, phase, error, pixels, constant, constant_error, slope, slope_error, model_deg(phases_deg.x), still_deg
    )


def read_amplitude_phase(path: Path) -> tuple[Array, Array]:
    """Return amplitude as a share of the free one and phase [degrees] of each pixel of an Asylum Igor wave.

    Raises: ConfigError naming the file and what it lacks.
    """
    try:
        wave, (values,) = read_in_child(f"{load_wave.__module__}:{load_wave.__name__}", path)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error
    notes = notes_of(wave)
    planes = dict(zip(wave["labels"][2], range(values.shape[-1]), strict=False)) if values.ndim == 3 else {}
    wanted = ("AmplitudeTrace", "PhaseTrace")
    missing = [name for name in wanted if name not in planes]
    missing += [name for name in ("FreeAirAmplitude", "AmpInvOLS") if name not in notes]
    if missing:
        raise ConfigError(f"{path}: lacks {', '.join(missing)}: it is not an image in tapping mode")
    amplitude, phase = (np.asarray(values[:, :, planes[name]], dtype=np.float64).ravel() for name in wanted)
    # The note gives the free amplitude in volts.
    return amplitude / (float(notes["FreeAirAmplitude"]) * float(notes["AmpInvOLS"])), phase


def amplitude_phase_figure(curve: AmplitudePhase) -> "Figure":
    """Draw the phase over the amplitude, the fit, a sample that dissipates no energy, and the residuals of the fit."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    error = np.maximum(curve.error_deg, 0.1)
    above.errorbar(curve.amplitude, curve.phase_deg, error, fmt="o", markersize=4, color="tab:red", label="measured")
    above.plot(curve.amplitude, curve.model_deg, "k-", label="fit: energy c + d (1 - a)")
    above.plot(curve.amplitude, curve.still_deg, "k:", label="a sample that takes no energy")
    above.set_ylabel("phase [degrees]")
    above.legend()
    below.errorbar(curve.amplitude, curve.phase_deg - curve.model_deg, error, fmt="o", markersize=4, color="tab:red")
    below.axhline(0.0, color="0.4", linewidth=0.8)
    below.set_ylabel("residual [degrees]")
    below.set_xlabel("amplitude a, as a share of the free one")
    return figure


def main() -> None:
    """Fit the image named by the first argument and write the figure to the file named by the second."""
    path, out = Path(sys.argv[1]), Path(sys.argv[2])
    curve = amplitude_phase(*read_amplitude_phase(path))
    with atomic_file(out) as part:
        amplitude_phase_figure(curve).savefig(part, dpi=110, format=out.suffix[1:] or "png")
    left = curve.phase_deg - curve.model_deg
    sys.stdout.write(
        f"{len(curve.amplitude)} spans of {curve.amplitude[0]:.3f} to {curve.amplitude[-1]:.3f} of the free amplitude\n"
        f"c = {curve.constant:.3f} +- {curve.constant_error:.3f}, d = {curve.slope:.2f} +- {curve.slope_error:.2f}\n"
        f"residuals: {np.sqrt(np.mean(left**2)):.2f} degrees RMS, {np.abs(left).max():.2f} at most\n{out}\n"
    )


if __name__ == "__main__":
    main()

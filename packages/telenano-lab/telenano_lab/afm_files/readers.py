"""Table of the reader functions for each kind of file; telenano calls them in a child process with limits."""

from telenano.files import Limits
from telenano.settings import FileReader

_LIBRARIES_BYTES = 2 << 30


def limits_of_libraries(size_bytes: int) -> Limits:
    """Return the limits for nanonispy2, whose imports need additional address space and time."""
    limits = Limits.of_size(size_bytes)
    return limits._replace(memory_bytes=limits.memory_bytes + _LIBRARIES_BYTES, cpu_s=2 * limits.cpu_s)


def limits_of_curves(size_bytes: int) -> Limits:
    """Return the limits for reading curves: one takes some 25 ms, however small it is, and has at least 13 kB."""
    limits = Limits.of_size(size_bytes)
    return Limits(limits.memory_bytes + (1 << 30), limits.cpu_s + 10 + size_bytes // 50_000, limits.wall_s + 60.0)


_CURVE = "telenano_lab.afm_files.curve_files:load_one"
_DEFLECTIONS = "telenano_lab.afm_files.curve_files:load_deflections"
_HDF5 = "telenano_lab.afm_files.hdf5_images:load_maps"
CURVES = FileReader(curve=_CURVE, deflections=_DEFLECTIONS, limits=limits_of_curves)
HDF5 = FileReader(heights=_HDF5, curve=_CURVE, deflections=_DEFLECTIONS, limits=limits_of_curves)
IGOR = CURVES._replace(heights="telenano_lab.afm_files.igor_waves:load_maps")
JPK_THERMAL = FileReader(spectrum="telenano_lab.afm_files.jpk_thermal:load_spectrum")
GWYDDION = FileReader(heights="telenano_lab.afm_files.gwyddion:load_maps")
NANONIS = FileReader(heights="telenano_lab.afm_files.nanonis:load_nanonis", limits=limits_of_libraries)
NANOSURF = CURVES._replace(
    heights="telenano_lab.afm_files.nanosurf:load_maps", spectrum="telenano_lab.afm_files.nanosurf:load_spectrum"
)
NANOSURF_HDF5 = CURVES._replace(heights="telenano_lab.afm_files.nanosurf:load_nhf_maps")
OTHER = CURVES._replace(heights="telenano_lab.afm_files.gwyddion:load_image")

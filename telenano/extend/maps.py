"""Recorded maps of one's own format under the tip: where a map is, the step over it, and the units of its values.

NPZ = MapFormat(MapParams, start, step, span_of, read_over_map)     # entry `npz` of `telenano.maps`
"""

import numpy as np
import numpy.typing as npt

from telenano.afm.felt import SI_UNITS as SI_UNITS
from telenano.afm.felt import UNITS as UNITS
from telenano.afm.sample_maps import MapFormat as MapFormat
from telenano.afm.sample_maps import OverMap as OverMap
from telenano.afm.sample_maps import Span as Span

Array = npt.NDArray[np.float64]

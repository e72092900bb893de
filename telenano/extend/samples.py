"""A sample of one's own under the tip: settings, and a pure step from a position of the base to force and distance."""

from services.afm_node.sample_models import SampleModel
from services.afm_node.step import AfmSample
from services.runtime.compiled import compiled
from services.runtime.config import Settings

__all__ = ["AfmSample", "SampleModel", "Settings", "compiled"]

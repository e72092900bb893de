"""A sample of one's own under the tip: settings, and a pure step from a position of the base to force and distance."""

from services.afm_node.physics.part import AfmSample, PlantInputs
from services.afm_node.physics.sample_models import SampleModel
from services.numerics.compiled import compiled
from services.runtime.settings.config import Settings

__all__ = ["AfmSample", "PlantInputs", "SampleModel", "Settings", "compiled"]

"""A sample of one's own under the tip: settings, and a pure step from a position of the base to force and distance."""

from services.afm_node.physics.part import AfmSample as AfmSample
from services.afm_node.physics.part import PlantInputs as PlantInputs
from services.afm_node.physics.sample_models import SampleModel as SampleModel
from services.numerics.compiled import compiled as compiled
from services.runtime.settings.config import Settings as Settings

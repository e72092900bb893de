"""A sample of one's own under the tip: settings, and a pure step from a position of the base to force and distance."""

from telenano.afm.part import AfmSample as AfmSample
from telenano.afm.part import PlantInputs as PlantInputs
from telenano.afm.sample_models import SampleModel as SampleModel

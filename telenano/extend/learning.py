"""What an environment to learn in is made of: the push of a particle as compiled steps, steering, and an interval."""

from telenano.afm.particles.adhered_sphere import KINDS as KINDS
from telenano.afm.particles.adhered_sphere import hold_of as hold_of
from telenano.afm.particles.push import X as X
from telenano.afm.particles.push import Y as Y
from telenano.afm.particles.push import packed as packed
from telenano.afm.particles.push import push_step as push_step
from telenano.afm.particles.steering import steered as steered
from telenano.afm.particles.tip_shape import Spring as Spring
from telenano.afm.particles.tip_shape import TipShape as TipShape
from telenano.afm.particles.tip_shape import tip_shape as tip_shape
from telenano.afm.particles.tip_shape import touch_distance_m as touch_distance_m
from telenano.analysis.intervals import wilson as wilson
from telenano.numerics.compiler import always_compiled as always_compiled

"""What an environment to learn in is made of: the push of a particle as compiled steps, steering, and an interval."""

from services.afm_node.physics.particles.adhered_sphere import KINDS as KINDS
from services.afm_node.physics.particles.adhered_sphere import hold_of as hold_of
from services.afm_node.physics.particles.push import X as X
from services.afm_node.physics.particles.push import Y as Y
from services.afm_node.physics.particles.push import packed as packed
from services.afm_node.physics.particles.push import push_step as push_step
from services.afm_node.physics.particles.steering import steered as steered
from services.afm_node.physics.particles.tip_shape import Spring as Spring
from services.afm_node.physics.particles.tip_shape import TipShape as TipShape
from services.afm_node.physics.particles.tip_shape import tip_shape as tip_shape
from services.afm_node.physics.particles.tip_shape import touch_distance_m as touch_distance_m
from services.numerics.compiled import always_compiled as always_compiled
from telenano.analysis.intervals import wilson as wilson

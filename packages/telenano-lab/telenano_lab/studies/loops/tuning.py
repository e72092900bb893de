"""Parameters of a law for a delay, by one stated rule, so that what is compared is the law and not its tuning.

The rule: on the given sample, with a hand of constant force, the law's loop tolerates twice the delay that the link has
at its longest. For the two laws whose loop passes the link (virtual impedance, position-force) that sets the damping
B_v; where inertia does not matter it is B_v = 4 G T / pi, G the gain of the loop. No less than the default is taken.
The others close no linear loop through the link, and keep their defaults at every delay.
"""

import functools
import math
from typing import Any

from telenano.sections import LAWS
from telenano_lab.studies.loops.theory import critical_delay_s, loop_model

TOLERATED_DELAYS = 2.0
_MOST_N_S_PER_M = 1e7

Settings = tuple[tuple[str, float | int | str | bool], ...]


@functools.lru_cache(maxsize=256)
def tuned(law: str, stiffness_n_per_m: float, longest_delay_s: float) -> Settings:
    """Return the dotted keys of the section `controller` that differ from their defaults.

    Args:
        law: The law.
        stiffness_n_per_m: The stiffness of the sample, K [N/m].
        longest_delay_s: The round trip of the link with its jitter [s].
    """
    config: Any = LAWS[law].config
    default = config()
    model = loop_model(law, default, stiffness_n_per_m)
    if model is None or critical_delay_s(model) >= TOLERATED_DELAYS * longest_delay_s:
        return ()
    from scipy.optimize import brentq

    def excess(log_damping: float) -> float:
        margin_s = critical_delay_s(model._replace(damping_n_s_per_m=math.exp(log_damping)))
        return min(margin_s, 1e6) - TOLERATED_DELAYS * longest_delay_s

    log_damping = brentq(excess, math.log(model.damping_n_s_per_m), math.log(_MOST_N_S_PER_M), xtol=1e-6)
    return ((f"{law}.damping_n_s_per_m", round(math.exp(log_damping), 1)),)

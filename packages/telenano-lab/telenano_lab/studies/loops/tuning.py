"""Tune a law for a delay by one stated rule, so that a comparison is one of laws and not of their tuning.

The rule: on the given sample, with a hand of constant force, the law's loop tolerates twice the longest delay of the
link. For the two laws whose loop passes the link (virtual impedance, position-force) this determines the damping B_v;
where inertia does not matter, B_v = 4 G T / pi, with G the gain of the loop. It is never less than the default. The
other laws close no linear loop through the link, and keep their defaults at every delay.
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
    """Return the dotted keys of section `controller` in which the tuned law differs from its defaults.

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

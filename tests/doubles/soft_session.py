"""A recorded session in which the hand feels a spring much too soft: a swing under passivity control."""

import json
import math
from pathlib import Path

from telenano.testing.recordings import record_fig12


def record_soft_session(folder: Path) -> Path:
    """Record a hand that presses a spring of 20 N/m, 3000 N/m at the hand, and swings at 1 Hz, in virtual time."""
    points = [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.3, "force_n": 1.0}]
    points += [
        {"time_s": 0.5 + 0.02 * n, "force_n": 1.0 + 0.3 * math.sin(2.0 * math.pi * 0.02 * n)} for n in range(350)
    ]
    operator = json.dumps({"kind": "force_profile", "points": points})
    settings = (
        f"haptic_node.operator={operator}",
        "afm_node.environment=spring",
        "afm_node.spring.stiffness_n_per_m=20",
        "afm_node.safety.retract_position_m=0.0",
        "realtime.rate_hz=200",
    )
    return record_fig12(folder, "passivity", settings, delay_s=0.0, programme_s=7.5, duration_s=7.9)

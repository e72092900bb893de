"""Numbers as JSON has them: it knows neither infinity nor NaN, which other readers refuse.

json.dumps(finite({"delay_s": math.inf}), allow_nan=False)
"""

import math
import sys
from typing import Any


def finite(value: Any) -> Any:
    """Return plain data as strict JSON holds it: what overflows at the greatest number, and no number as null."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else math.copysign(sys.float_info.max, value)
    return value

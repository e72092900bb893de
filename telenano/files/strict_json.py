"""Conversion of numbers to strict JSON, which has neither infinity nor NaN, so that other readers accept it.

json.dumps(finite({"delay_s": math.inf}), allow_nan=False)
"""

import math
import sys
from typing import Any


def finite(value: Any) -> Any:
    """Return plain data for strict JSON: infinity becomes the largest float with its sign, and NaN becomes null."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else math.copysign(sys.float_info.max, value)
    return value

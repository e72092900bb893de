"""What `borrowed` is in compiled code: the value, with arrays that have no owner (ADR 0010)."""

from typing import Any

from numba.core import cgutils, types
from numba.extending import lower_builtin, type_callable

from services.numerics.compiled import borrowed

# their declarations name only some of their types
_build: Any = cgutils
_declare: Any = type_callable
_lower: Any = lower_builtin


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = _build.create_struct_proxy(kind)(context, builder, value=value)
        # numba counts no references to an array whose memory has no owner
        array.meminfo = _build.get_null_value(array.meminfo.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        parts: Any = kind
        for place, inner in enumerate(parts):
            part = _without_owner(context, builder, inner, builder.extract_value(value, place))
            value = builder.insert_value(value, part, place)
    return value


def _lowered(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    return _without_owner(context, builder, signature.args[0], given[0])


_declare(borrowed)(lambda context: lambda value: value)
_lower(borrowed, types.Any)(_lowered)

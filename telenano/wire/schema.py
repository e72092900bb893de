"""JSON Schema of a message, generated from its declaration, for recordings, viewers and clients in other languages."""

import inspect
import sys
from typing import Annotated, Any, Literal, get_args, get_origin

import msgspec

from telenano.wire.messages import Record


def json_schema(model: type[Record]) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a record, with the records inside it under `$defs`.

    The choices of a field are in the order of their declaration, a pattern ends with `$`, and bytes have the format
    `binary`.
    """
    (_,), definitions = msgspec.json.schema_components([model])
    kinds = {kind.__name__: kind for kind in records_in(model)}
    for name, kind in kinds.items():
        schema = definitions[name]
        schema["description"] = inspect.cleandoc(kind.__doc__ or "")
        for field in msgspec.structs.fields(kind):
            _restore(schema["properties"][field.name], field.type)
    whole = definitions.pop(model.__name__)
    return {**({"$defs": definitions} if definitions else {}), **whole}


def _restore(schema: dict[str, Any], kind: Any) -> None:
    """Change the schema of a field from the form of msgspec to that of the contract."""
    kind = kind.__origin__ if get_origin(kind) is Annotated else kind
    for choice in (kind, *get_args(kind)):
        if get_origin(choice) is Literal:
            listed = next(part for part in (schema, *schema.get("anyOf", ())) if "enum" in part)
            listed |= {"type": "string", "enum": list(get_args(choice))}
    _simplify(schema)


def _simplify(schema: dict[str, Any]) -> None:
    if schema.pop("contentEncoding", ""):
        # The wire has bytes, which JSON lacks.
        schema["format"] = "binary"
    if schema.get("maximum") == sys.float_info.max:
        # Every JSON number is finite anyway.
        del schema["maximum"], schema["minimum"]
    if schema.get("items") is False:
        # minItems and maxItems already exclude further items.
        del schema["items"]
    if "pattern" in schema:
        schema["pattern"] = schema["pattern"].replace(r"\Z", "$")
    parts = [schema[key] for key in ("items", "additionalProperties") if isinstance(schema.get(key), dict)]
    for part in (*parts, *schema.get("anyOf", ()), *schema.get("prefixItems", ())):
        _simplify(part)


def records_in(kind: Any) -> list[type[Record]]:
    """Return the records in a type: a record itself and those nested in it, or those in a union or tuple."""
    kind = kind.__origin__ if get_origin(kind) is Annotated else kind
    if isinstance(kind, type) and issubclass(kind, Record):
        return [kind, *(record for field in msgspec.structs.fields(kind) for record in records_in(field.type))]
    return [] if get_origin(kind) is Literal else [record for part in get_args(kind) for record in records_in(part)]

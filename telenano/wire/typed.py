"""A faster way through the declared contract for messages of scalars and vectors, such as those of the loop.

Generated from the same models: one pass in C decodes, checks types and ranges; another checks and encodes what a node
publishes. Whatever is not perfectly in order is left to the declared models, whose errors and reasons are the contract:
what this accepts they accept, with the same values and bytes, and it refuses nothing.
"""

import re
import sys
from collections.abc import Callable, Mapping
from types import UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    NotRequired,
    TypedDict,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
)

import msgpack
import msgspec
from annotated_types import Ge, Le, Lt, MaxLen, MinLen
from pydantic import BaseModel, FailFast
from pydantic.fields import FieldInfo

from telenano.wire.messages import SOURCE_PATTERN, Message, Scalar
from telenano.wire.ranges import Range

# Texts with a pattern that the declared model has accepted, such as the few names of nodes.
_MOST_TEXTS = 256
# A node sends only a few combinations of the keys that may be absent.
_MOST_COMBINATIONS = 256
M = TypeVar("M", bound=BaseModel)
_REFUSALS = (msgspec.MsgspecError, ValueError, TypeError, RecursionError, OverflowError)


class TypedForm(NamedTuple):
    """The fast way of one topic.

    `fields` returns the fields of a payload, None to leave it to the declared model; it has not looked at texts. `read`
    returns the message, and `compose` the message with these fields and its bytes, likewise. `note` takes what the
    declared model has accepted.
    """

    fields: Callable[[bytes], dict[str, Any] | None]
    read: Callable[[bytes], Message | None]
    compose: Callable[[Mapping[str, Any]], tuple[Message, bytes] | None]
    note: Callable[[Message], None]


def typed_form(model: type[Message], most_bytes: int) -> TypedForm | None:
    """Return the fast way for a model, None if it holds more than scalars and vectors of them.

    It takes every combination of the keys that may be absent. A combination is known to `read` once the declared model
    has accepted it, as texts are.
    """
    needed: dict[str, Any] = {}
    optional: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        if name not in model.additions:
            form = _form(field.annotation, tuple(field.metadata)) if field.is_required() else None
            needed[name] = form
        else:
            # None stands for an absent key.
            form = _form(get_args(field.annotation)[0])
            form = None if field.metadata and form is not str else form
            optional[name] = form
        if form is None:
            return None
    # The declared model judges a version that is not known here, and any text that is new.
    needed["v"] = Annotated[int, msgspec.Meta(ge=1, le=model.version)]
    return _compiled(model, needed, optional, most_bytes)


def typed_rows(model: type[Message], most_bytes: int) -> TypedForm | None:
    """Return the fast way to compose a message of scalars and one array of records of scalars, None for any other.

    Such as link/fates: the link sends thousands of rows a second, given as mappings. To read it is left to the declared
    model.
    """
    columns = {name: columns for name, field in model.model_fields.items() if (columns := _columns(field))}
    if len(columns) != 1 or model.additions:
        return None
    [(rows, (kind, row))] = columns.items()
    fields = [(name, row if name == rows else _form_of_field(field)) for name, field in model.model_fields.items()]
    if any(form is None for _, form in fields):
        return None
    whole = msgspec.defstruct(model.__name__, fields, forbid_unknown_fields=True, gc=False)
    convert, encode, as_dict = msgspec.convert, msgspec.msgpack.Encoder().encode, msgspec.structs.asdict
    construct, construct_row = _constructor(model), _constructor(kind)
    sources: set[str] = set()

    def compose(given: Mapping[str, Any]) -> tuple[Message, bytes] | None:
        try:
            made: Any = convert(given, whole)
            payload = encode(made)
        except _REFUSALS:
            return None
        if made.src not in sources or made.v != model.version or len(payload) > most_bytes:
            return None
        found = as_dict(made)
        found[rows] = tuple([construct_row(as_dict(row)) for row in found[rows]])
        return construct(found), payload

    def note(message: Message) -> None:
        if len(sources) < _MOST_TEXTS:
            sources.add(message.src)

    return TypedForm(lambda payload: None, lambda payload: None, compose, note)


def typed_header(model: type[Message], most_bytes: int) -> Callable[[bytes], tuple[int, int, str] | None] | None:
    """Return what returns seq, t_ns and src of a payload that is valid as a whole, and None for one that it leaves.

    For those who check messages and do nothing with them, of records, maps and texts as well; None where the model has
    more than that. What msgspec makes of the payload is encoded again, and has to be these bytes: so no key came twice,
    and no number was converted.
    """
    record = _record(model)
    if record is None:
        return None
    decode, encode = msgspec.msgpack.Decoder(record).decode, msgspec.msgpack.Encoder().encode
    is_source = re.compile(SOURCE_PATTERN).fullmatch
    sources: set[str] = set()

    def header(payload: bytes) -> tuple[int, int, str] | None:
        if len(payload) > most_bytes:
            return None
        try:
            found: Any = decode(payload)
        except _REFUSALS:
            return None
        if encode(found) != payload:
            return None
        if found.src not in sources:
            # the few names of nodes, of which the pattern takes as long as all the rest
            if not is_source(found.src) or len(sources) >= _MOST_TEXTS:
                return None
            sources.add(found.src)
        return found.seq, found.t_ns, found.src

    return header


def _record(model: type[BaseModel]) -> Any:
    """Return the type that msgspec decodes a record as, checked as a whole; None for one with validators of its own."""
    validators = model.__pydantic_decorators__
    additions = model.additions if issubclass(model, Message) else ()
    if validators.model_validators or validators.field_validators or validators.validators:
        return None
    columns: list[tuple[str, Any] | tuple[str, Any, None]] = []
    for name, field in model.model_fields.items():
        form = _checked(field.annotation, tuple(field.metadata))
        if issubclass(model, Message) and name in ("v", "src"):
            form = Annotated[str, msgspec.Meta(max_length=64)]
            form = form if name == "src" else Annotated[int, msgspec.Meta(ge=1, le=model.version)]
        if form is None or field.is_required() is (name in additions):
            return None
        # None stands for a key that is absent, and is never on the wire.
        columns.append((name, form, None) if name in additions else (name, form))
    return msgspec.defstruct(
        model.__name__, columns, forbid_unknown_fields=True, gc=False, kw_only=True, omit_defaults=True
    )


def _checked(annotation: Any, metadata: tuple[Any, ...] = ()) -> Any:
    """Return the type that msgspec checks a field as, None for one that is left to the declared model."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _checked(parts[0], (*_rules(annotation.__metadata__), *metadata))
    if annotation == Scalar:
        # The rest of what is annotated only shortens the error of the declared model.
        return bool | int | Annotated[float, msgspec.Meta(ge=-sys.float_info.max, le=sys.float_info.max)] | str
    metadata = tuple(rule for rule in metadata if not isinstance(rule, FailFast))
    if annotation is str:
        return _checked_text(metadata)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return None if metadata else _record(annotation)
    if origin in (Union, UnionType) and len(parts) == 2 and parts[1] is type(None):
        form = _checked(parts[0], metadata)
        return None if form is None else form | None
    if origin is dict or (origin is tuple and parts[1:] == (Ellipsis,)):
        item = _checked(parts[origin is dict])
        if item is None or len(metadata) != 1 or not isinstance(metadata[0], MaxLen):
            return None
        whole = cast(Any, dict)[str, item] if origin is dict else cast(Any, tuple)[item, ...]
        return Annotated[whole, msgspec.Meta(max_length=metadata[0].max_length)]
    return _form(annotation, metadata)


def _checked_text(metadata: tuple[Any, ...]) -> Any:
    rules: dict[str, Any] = {}
    for rule in metadata:
        pattern = getattr(rule, "pattern", None)
        if isinstance(rule, MaxLen):
            rules["max_length"] = rule.max_length
        elif isinstance(rule, MinLen):
            rules["min_length"] = rule.min_length
        elif isinstance(pattern, str) and pattern.endswith("$"):
            # At the end of a text Python's $ permits a new line, and that of the declared model does not.
            rules["pattern"] = pattern[:-1] + r"\Z"
        else:
            return None
    return Annotated[str, msgspec.Meta(**rules)] if rules else str


def _columns(field: FieldInfo) -> tuple[type[BaseModel], Any] | None:
    """Return the record that a field is an array of, and the type that msgspec decodes it as."""
    parts = get_args(field.annotation)
    if get_origin(field.annotation) is not tuple or parts[1:] != (Ellipsis,) or not isinstance(parts[0], type):
        return None
    most = [rule.max_length for rule in field.metadata if isinstance(rule, MaxLen)]
    if not issubclass(parts[0], BaseModel) or not most:
        return None
    fields = [(name, _form_of_field(column)) for name, column in parts[0].model_fields.items()]
    if any(form is None for _, form in fields):
        return None
    record = msgspec.defstruct(parts[0].__name__, fields, forbid_unknown_fields=True, gc=False)
    return parts[0], Annotated[cast(Any, tuple)[record, ...], msgspec.Meta(max_length=most[0])]


def _form_of_field(field: FieldInfo) -> Any:
    """Return the type of a field of scalars; of a text, with the length that it may have."""
    if field.annotation is not str:
        return _form(field.annotation, tuple(field.metadata))
    most = [rule.max_length for rule in field.metadata if isinstance(rule, MaxLen)]
    return Annotated[str, msgspec.Meta(max_length=most[0])] if most else None


def _compiled(model: type[Message], needed: dict[str, Any], optional: dict[str, Any], most_bytes: int) -> TypedForm:
    pack_header = msgpack.Packer().pack_map_header
    # A map of so many keys begins with these bytes.
    heads = {count: bytes(pack_header(count)) for count in range(len(needed), len(needed) + len(optional) + 1)}
    keys = needed | {name: NotRequired[form] for name, form in optional.items()}
    decode = msgspec.msgpack.Decoder(TypedDict(model.__name__, keys)).decode  # type: ignore[operator]
    columns = [
        (name, optional[name] | None, None) if name in optional else (name, needed[name]) for name in model.model_fields
    ]
    record = msgspec.defstruct(
        model.__name__, columns, forbid_unknown_fields=True, gc=False, kw_only=True, omit_defaults=True
    )
    convert, encode, as_dict = msgspec.convert, msgspec.msgpack.Encoder().encode, msgspec.structs.asdict
    construct = _constructor(model)
    sources: set[str | None] = set()
    texts: dict[str, set[str | None]] = {
        name: set() for name, form in (needed | optional).items() if form is str and name != "src"
    }
    others, names = tuple(texts.items()), tuple(model.model_fields)
    # For each combination of keys, in the order of the model, this has the beginning of the map and the keys that it
    # lacks.
    combinations: dict[tuple[str, ...], tuple[bytes, dict[str, None]]] = {}

    def fields_of(payload: bytes) -> dict[str, Any] | None:
        if len(payload) > most_bytes:
            return None
        try:
            fields: dict[str, Any] = decode(payload)
        except _REFUSALS:
            return None
        # The number of keys is right and all of them are known, so none is there twice.
        return fields if payload.startswith(heads[len(fields)]) else None

    def read(payload: bytes) -> Message | None:
        if len(payload) > most_bytes:
            return None
        try:
            fields = decode(payload)
        except _REFUSALS:
            return None
        # the order of keys is free on the wire, and that of the model in a message
        found = combinations.get(tuple(fields))
        if found is None or fields["src"] not in sources:
            return None
        head, absent = found
        if not payload.startswith(head):
            return None
        if absent:
            fields.update(absent)
        for name, known in others:
            if fields[name] not in known:
                return None
        return construct(fields)

    def compose(fields: Mapping[str, Any]) -> tuple[Message, bytes] | None:
        try:
            made: Any = convert(fields, record)
        except _REFUSALS:
            return None
        if made.src not in sources:
            return None
        for name, known in others:
            if getattr(made, name) not in known:
                return None
        payload = encode(made)
        return None if len(payload) > most_bytes else (construct(as_dict(made)), payload)

    def note(message: Message) -> None:
        for name, known in (("src", sources), *others):
            if len(known) < _MOST_TEXTS:
                known.add(getattr(message, name))
        absent = {name: None for name in optional if getattr(message, name) is None}
        present = tuple(name for name in names if name not in absent)
        if len(combinations) < _MOST_COMBINATIONS:
            combinations[present] = heads[len(present)], absent

    return TypedForm(fields_of, read, compose, note)


def _constructor(model: type[M]) -> Callable[[dict[str, Any]], M]:
    """Return what makes a message of all its fields, which are known to be good, with `fields` itself inside.

    As `model_construct`, which takes six times as long.
    """
    # the slots of pydantic's own base; a frozen model refuses what goes past them
    slots = vars(BaseModel)
    set_fields, set_names = slots["__dict__"].__set__, slots["__pydantic_fields_set__"].__set__
    set_extra, set_private = slots["__pydantic_extra__"].__set__, slots["__pydantic_private__"].__set__
    new, names = object.__new__, set(model.model_fields)

    def construct(fields: dict[str, Any]) -> M:
        message = new(model)
        set_fields(message, fields)
        set_names(message, names)
        set_extra(message, None)
        set_private(message, None)
        return message

    return construct


def _form(annotation: Any, metadata: tuple[Any, ...] = ()) -> Any:
    """Return the type that msgspec decodes a field as, None for one that is left to the declared model."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _form(parts[0], (*_rules(annotation.__metadata__), *metadata))
    if annotation is str:
        return str
    if annotation is float and len(metadata) == 1 and isinstance(metadata[0], Range):
        return Annotated[float, msgspec.Meta(ge=metadata[0].low, le=metadata[0].high)]
    if annotation is int:
        return _whole_number(metadata)
    if metadata:
        return None
    if annotation is bool or (origin is Literal and all(isinstance(part, str) for part in parts)):
        return annotation
    if origin is tuple and Ellipsis not in parts:
        forms = tuple(map(_form, parts))
        return None if None in forms else cast(Any, tuple)[forms]
    if origin in (Union, UnionType) and len(parts) == 2 and parts[1] is type(None):
        form = _form(parts[0])
        return None if form is None or form is str else form | None
    return None


def _rules(metadata: tuple[Any, ...]) -> list[Any]:
    """Return the rules of a type, with those that pydantic's `Field` holds: a field's own it has taken out already."""
    held = [found.metadata if isinstance(found, FieldInfo) else [found] for found in metadata]
    return [rule for rules in held for rule in rules]


def _whole_number(metadata: tuple[Any, ...]) -> Any:
    bounds: dict[str, int] = {}
    for rule in metadata:
        if isinstance(rule, Ge):
            bounds["ge"] = cast(int, rule.ge)
        elif isinstance(rule, Le):
            bounds["le"] = cast(int, rule.le)
        elif isinstance(rule, Lt):
            bounds["le"] = cast(int, rule.lt) - 1
        else:
            return None
    low, high = bounds.get("ge"), bounds.get("le")
    # the bounds of 64 bits are those of the type
    low = None if low == -(2**63) else low
    return Annotated[int, msgspec.Meta(ge=low, le=high)]

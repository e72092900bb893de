"""Entries of packages that have a section of their own in a node's settings, each imported when it is first asked for.

The names of the sections come from the metadata of the packages; a package is imported when a scenario has its section.
"""

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

from pydantic import BaseModel
from pydantic_core import PydanticKnownError, PydanticOmit, core_schema

from telenano.settings import plugins
from telenano.settings.config import package_fields
from telenano.settings.known_packages import known_of, where_it_is
from telenano.settings.plugins import LoadedEntries, load

T = TypeVar("T")


class SharedSection(NamedTuple):
    """A section that does not belong to one entry alone, such as one that several drivers of a package share."""

    config: type[BaseModel]


class Entries(Generic[T]):
    """The entries of a kind, each of which has `config`, the model of its section.

    A `SharedSection` is a section as well, and is no entry that `find` and `all` return.

    Args:
        kind: The kind of entries, such as `samples`.
        what: The noun for one entry in descriptions, such as `layer`.
        check: Returns the usable part of an entry, as for `plugins.load`; None leaves out those for another section.
        taken: The other keys of the section, which no entry may use.
        own: The names of the node itself, for which `find` returns None.
        absent: The word for such a section in `known_packages`, where one of this project's packages has some.
        called: The word for the value of the key that names an entry there; the one of `absent` if not given.
    """

    def __init__(
        self,
        kind: str,
        what: str,
        check: Callable[[str, Any], T | SharedSection | None],
        taken: Collection[str],
        own: Collection[str] = (),
        absent: str = "",
        called: str = "",
    ) -> None:
        self._kind, self._what, self._check = kind, what, check
        self._taken, self._own, self._absent = frozenset(taken), tuple(own), absent
        self._called = called or absent
        self._asked: dict[str, T | SharedSection | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the installed entries that may be of this kind; only an import shows whether they are."""
        return tuple(name for name in plugins.installed(self._kind) if name not in self._taken)

    def find(self, name: str) -> T | None:
        """Return the entry of a name, importing it now; None where no package has one.

        Raises:
            ValueError: The entry cannot be used; the message says why.
        """
        found = None if name in self._own else self.with_section(name)
        return None if isinstance(found, SharedSection) else found

    def with_section(self, name: str) -> T | SharedSection | None:
        """Return what has the section of a name, importing it now; ValueError as `find`."""
        if name not in self._asked:
            loaded = self._loaded(name)
            if name in loaded.problems:
                raise ValueError(loaded.problems[name])
            self._asked[name] = loaded.found.get(name)
        return self._asked[name]

    def is_usable(self, name: str) -> bool:
        """Return whether there is an entry of a name that can be used, importing it now."""
        return name in self._loaded(name).found

    def all(self) -> LoadedEntries[T]:
        """Return every entry, importing all of them now."""
        found, problems = self._loaded()
        return LoadedEntries({name: e for name, e in found.items() if not isinstance(e, SharedSection)}, problems)

    def _loaded(self, name: str | None = None) -> LoadedEntries[T | SharedSection]:
        return load(self._kind, self._check, self._taken, name)

    def sections(self) -> Any:
        """Return the fields of a section for the settings of each entry; its model is loaded at validation."""
        about = f"Settings of {self._what}"
        names = dict.fromkeys((*self.names, *known_of(self._absent)))
        return package_fields({n: (Annotated[Any, _Section(self, n)], None, f"{about} {n}.") for n in names})

    def name_type(self) -> Any:
        """Return the type of the key that names one of the node's own or an entry, which is then imported."""
        return Annotated[str, _Name(self, self._own, self._called)]

    def where_it_is(self, name: str) -> str:
        """Return a hint at the package of this project that has an entry but is not installed; empty where none has."""
        return where_it_is(f"{self._absent} {name}")


@dataclass(frozen=True)
class _Section:
    """The validator of an entry's section; None passes, because dumped settings hold None for another node's entry."""

    entries: Entries[Any]
    name: str

    @property
    def model(self) -> type[BaseModel] | None:
        """The model of the section, whose package is imported now; None where there is none. ValueError as `find`."""
        entry = self.entries.with_section(self.name)
        return None if entry is None else entry.config

    def _checked(self, value: Any, info: core_schema.ValidationInfo) -> BaseModel | None:
        if value is None:
            return None
        config = self.model
        if config is None:
            if hint := self.entries.where_it_is(self.name):
                raise ValueError(hint)
            raise PydanticKnownError("extra_forbidden")
        if info.mode == "json":
            # A strict model accepts a list as a tuple only when it reads JSON.
            return config.model_validate_json(json.dumps(value))
        return config.model_validate(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.with_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        try:
            config = self.model
        except ValueError:
            config = None
        if config is None:
            raise PydanticOmit
        return {"anyOf": [handler(config.__pydantic_core_schema__), {"type": "null"}]}


@dataclass(frozen=True)
class _Name:
    """The validator of a key that names an entry, such as `driver`."""

    entries: Entries[Any]
    own: tuple[str, ...]
    called: str

    def _checked(self, value: str) -> str:
        if value in self.own or self.entries.find(value) is not None:
            return value
        if hint := where_it_is(f"{self.called} {value}"):
            raise ValueError(hint)
        *names, last = map(repr, self._known())
        raise PydanticKnownError("literal_error", {"expected": f"{', '.join(names)} or {last}"})

    def _known(self) -> tuple[str, ...]:
        return (*self.own, *self.entries.all().found)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"enum": list(self._known()), "type": "string"}

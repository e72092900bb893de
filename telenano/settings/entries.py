"""Entries of packages that have a section of their own in a node's settings, each imported when it is asked for.

The names of the sections come from the metadata of the packages; a package is imported when a scenario has its section.
"""

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from pydantic import BaseModel, Field
from pydantic_core import PydanticKnownError, PydanticOmit, core_schema

from telenano.settings import plugins
from telenano.settings.known_packages import KNOWN_PACKAGES
from telenano.settings.plugins import Loaded, load
from telenano.wire.extras import how_to_add_package

T = TypeVar("T")


class Entries(Generic[T]):
    """The entries of a kind, each of which has `config`, the model of its section.

    Args:
        kind: The kind of entries, such as `layers`.
        what: What one of them is, such as `layer`.
        check: Returns what is used of an entry, as for `plugins.load`.
        taken: What else in the section has a name.
        own: Names that are no entries of packages.
    """

    def __init__(
        self,
        kind: str,
        what: str,
        check: Callable[[str, Any], T | None],
        taken: Collection[str],
        own: Collection[str] = (),
    ) -> None:
        self._kind, self._what, self._check = kind, what, check
        self._taken, self._own = frozenset(taken), tuple(own)
        self._asked: dict[str, T | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names that could be entries of this kind, of which only an import tells."""
        return tuple(name for name in plugins.installed(self._kind) if name not in self._taken)

    def find(self, name: str) -> T | None:
        """Return the entry of that name, imported now; None where no package has one.

        Raises:
            ValueError: It cannot be used; the message says why.
        """
        if name in self._own:
            return None
        if name not in self._asked:
            loaded = load(self._kind, self._check, self._taken, name)
            if name in loaded.problems:
                raise ValueError(loaded.problems[name])
            self._asked[name] = loaded.found.get(name)
        return self._asked[name]

    def all(self) -> Loaded[T]:
        """Return every entry, all of them imported now."""
        return load(self._kind, self._check, self._taken)

    def sections(self) -> dict[str, Any]:
        """Return the fields of a section for the settings of each entry; its model is loaded at validation."""
        return {
            name: (Annotated[Any, _Section(self, name)], Field(None, description=f"Settings of {self._what} {name}."))
            for name in self.names
        }


def missing_entry(kind: str, name: object) -> str:
    """Return which package of this project has an entry and how it is installed; empty where none has.

    Args:
        kind: What the entry is, such as `driver` or `layer`.
        name: Its name.
    """
    package = KNOWN_PACKAGES.get(f"{kind} {name}", "")
    return f"the {kind} {name} is in the package {package}: {how_to_add_package(package)}" if package else ""


@dataclass(frozen=True)
class _Section:
    """The rule of an entry's section; what is written out of one node has those of another's entries, as None."""

    entries: Entries[Any]
    name: str

    def _checked(self, value: Any, info: core_schema.ValidationInfo) -> BaseModel | None:
        if value is None:
            return None
        entry = self.entries.find(self.name)
        if entry is None:
            raise PydanticKnownError("extra_forbidden")
        config: type[BaseModel] = entry.config
        if info.mode == "json":
            # A strict model takes a list for a tuple from JSON alone.
            return config.model_validate_json(json.dumps(value))
        return config.model_validate(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.with_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        entry = self.entries.all().found.get(self.name)
        if entry is None:
            raise PydanticOmit
        return {"anyOf": [handler(entry.config.__pydantic_core_schema__), {"type": "null"}]}

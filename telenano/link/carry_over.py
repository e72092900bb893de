"""Carrying over the link's models when its settings change: which ones continue, and which restart.

A model is made from a part of the settings, its definition, and has a key. It continues with its state if the new
settings have a model of the same key and definition, so the change of one setting does not restart other models. A
delay has no model: a changed one applies to the messages that arrive from then on.

| model | its definition |
|---|---|
| origin of a delay or loss trace | that trace, and the content of its file |
| message number, if a trace goes by it | both traces |
| queue with its server | rate, delivery trace, the content of its file, limits |
| slots | slots |
| outages | outage, except its effect on messages (`mode`) |
| jitter | jitter, and the content of its table |
| loss, duplication, corruption, `apply_probability` | probability and correlation |
| loss by chains | the chain |
| overtaking | reordering |

A stream of random numbers continues as long as the seed stays; another seed restarts all models. If topics move between
blocks of settings, all queues are rebuilt, so that the messages that wait go first and the order is kept.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

Key = tuple[str, ...]
Model = TypeVar("Model")


class ModelDefinition(NamedTuple):
    """A model, or a number that stands for one, with its definition."""

    definition: object
    model: Any


class ModelTable:
    """The models under the settings in force, which take over those of the previous table."""

    def __init__(self, before: Mapping[Key, ModelDefinition] | None = None) -> None:
        self._before = before or {}
        self.models: dict[Key, ModelDefinition] = {}

    def take(self, key: Key, definition: object, make: Callable[[], Model]) -> Model:
        """Return the model of a key from this table or the previous one if the definition is equal, else a new one.

        Args:
            key: The key of the model.
            definition: The part of the settings that defines the model.
            make: Factory of a new model.
        """
        known = self.models.get(key) or self._before.get(key)
        if known is None or known.definition != definition:
            known = ModelDefinition(definition, make())
        self.models[key] = known
        model: Model = known.model
        return model

    def close(self) -> None:
        """Drop the models of the previous table that were not taken over."""
        self._before = {}

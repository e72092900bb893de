"""What of the models of the link continues when its settings are changed, and what begins anew.

A model is made from a part of the settings, its definition, and has a key. It continues, with its state, where the
settings that come into force have one of the same key and definition; so a change of one key does not restart the
others. A delay has no model: a changed one holds for the messages that arrive from then on.

| model | its definition |
|---|---|
| origin of a delay or loss trace | that trace, and what its file holds |
| number of messages that a trace goes by | both traces |
| queue with its server | rate, delivery trace, what its file holds, limits |
| slots | slots |
| outages | outage, but for what it does with messages (`mode`) |
| jitter | jitter, and what its table holds |
| loss, duplication, corruption, `apply_probability` | probability and correlation |
| loss by chains | the chain |
| overtaking | reordering |

A stream of random numbers continues as long as the seed stays; another seed begins all models anew. Queues are made
again where topics move between blocks of settings, so that what waits goes first and order holds.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

Key = tuple[str, ...]
Model = TypeVar("Model")


class ModelDefinition(NamedTuple):
    """A model, or a number that stands for one, and what defines it."""

    definition: object
    model: Any


class ModelTable:
    """The models under the settings in force, which take over those of the table before."""

    def __init__(self, before: Mapping[Key, ModelDefinition] | None = None) -> None:
        self._before = before or {}
        self.models: dict[Key, ModelDefinition] = {}

    def take(self, key: Key, definition: object, make: Callable[[], Model]) -> Model:
        """Return the model of a key: that of this table or the one before, if its definition is the same, or a new one.

        Args:
            key: The key of the model.
            definition: What defines it.
            make: Makes a new one.
        """
        known = self.models.get(key) or self._before.get(key)
        if known is None or known.definition != definition:
            known = ModelDefinition(definition, make())
        self.models[key] = known
        model: Model = known.model
        return model

    def close(self) -> None:
        """Forget the models of before that were not taken over."""
        self._before = {}

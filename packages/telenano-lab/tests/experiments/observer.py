"""Simulated observers with a known threshold."""

import random

import numpy as np
from telenano_lab.experiments.psychophysics.function import Psychometric


class Observer:
    """Answers by a psychometric function, independently from trial to trial."""

    def __init__(self, model: Psychometric, threshold: float, width: float, lapse: float, seed: int) -> None:
        """Prepare an observer.

        Args:
            model: The family of its function.
            threshold: The level at which F is 1/2.
            width: The width of the function on its axis.
            lapse: The share of wrong answers far above the threshold.
            seed: Decides its answers.
        """
        self._model, self._width, self._lapse = model, np.asarray(width), np.asarray(lapse)
        self._threshold = model.on_axis([threshold])
        self._source = random.Random(seed)

    def share(self, level: float) -> float:
        """Return how likely a correct answer is at a level."""
        model = self._model
        return float(model.share(model.on_axis([level]), self._threshold, self._width, self._lapse)[0])

    def answer(self, level: float) -> bool:
        """Return whether the next answer, at a level, is correct."""
        return self._source.random() < self.share(level)

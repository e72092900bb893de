"""The bench of an assembly on a running rig, whose images and pushes are programs of the instrument there."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from telenano.sections import AfmConfig
from telenano.wire import RigError, Scalar
from telenano_lab.assembly.run import ProgramBench
from telenano_lab.microscopy.image_files import LiveImage
from telenano_lab.microscopy.live_program import run_program

Array = npt.NDArray[np.float64]


class LiveBench(ProgramBench):
    """The instrument of a running rig.

    Args:
        config: The known properties of the tip and of the kind of particle.
        site_file: The site file of the rig.
    """

    def __init__(self, config: AfmConfig, site_file: Path) -> None:
        super().__init__(config)
        self._site_file = site_file

    @property
    def time_s(self) -> float:
        return time.monotonic()

    def lines(self, keys: dict[str, Scalar]) -> Iterator[tuple[int, Array]]:
        image, _ = self._run(keys)
        for heights in (image.trace_m, image.retrace_m):
            yield from enumerate(heights)

    def values(self, keys: dict[str, Scalar]) -> Mapping[str, Scalar]:
        _, values = self._run(keys)
        if values is None:
            raise RigError("the instrument does not report what it has pushed: update telenano there")
        return values

    def _run(self, keys: dict[str, Scalar]) -> tuple[LiveImage, Mapping[str, Scalar] | None]:
        """Run a program to its end and return its image and values; RigError if it does not finish."""
        image = LiveImage()
        report = run_program(self._site_file, keys, image, lambda report: "")
        if report.state != "finished":
            raise RigError(report.text)
        return image, report.values

"""Patterns of places: a line, a square, a ring, or those of a file."""

import math
from pathlib import Path

from proto.errors import ConfigError
from studies.assembly.plan import Point

NAMES = ("line", "square", "ring")


def pattern(name: str, count: int, spacing_m: float) -> list[Point]:
    """Return the places of a pattern [m], its middle at 0, 0.

    Args:
        name: line, square, ring, or a file with a line `x y` [m] for each place.
        count: How many places a named pattern has.
        spacing_m: Their least distance [m].

    Raises:
        ConfigError: The pattern is not known, the file cannot be read, or a square cannot have that number.
    """
    if name == "line":
        return [((i - 0.5 * (count - 1)) * spacing_m, 0.0) for i in range(count)]
    if name == "ring":
        radius = 0.5 * spacing_m / math.sin(math.pi / count) if count > 1 else 0.0
        angles = [2.0 * math.pi * i / count for i in range(count)]
        return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]
    if name == "square":
        side = count // 4
        if count % 4 or side == 0:
            raise ConfigError(f"--pattern square: its outline has 4, 8, 12, … places, not {count}")
        half = 0.5 * side * spacing_m
        edge = [(-half + i * spacing_m, -half) for i in range(side)]
        return [turned for x, y in edge for turned in ((x, y), (-y, x), (-x, -y), (y, -x))]
    path = Path(name)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        known = ", ".join(NAMES)
        raise ConfigError(
            f"--pattern {name}: is none of {known}, and cannot be read as a file: {error.strerror}"
        ) from error
    places = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            x, y = (float(word) for word in words)
        except ValueError as error:
            raise ConfigError(f"--pattern {name}, line {number}: must be x and y in m, such as 1e-6 0") from error
        places.append((x, y))
    if not places:
        raise ConfigError(f"--pattern {name}: has no places; a line is x and y in m, such as 1e-6 0")
    return places

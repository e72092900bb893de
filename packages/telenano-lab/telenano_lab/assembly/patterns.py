"""Patterns of target places: a line, a square, a ring, letters, or the places in a file."""

import math
from pathlib import Path

from telenano.files import read_regular
from telenano.wire import ConfigError
from telenano_lab.assembly.plan import Point

# A line in a file of places has about thirty characters.
_LARGEST_BYTES = 1 << 20

NAMES = ("line", "square", "ring", "letters:TEXT")
# A character has five rows of three places, the top one first: an octal digit each, whose highest bit is on the left.
_LETTERS = "25755 65656 34443 65556 74647 74644 34553 55755 22222 11152 55655 44447 57755"
_LETTERS += " 65555 25552 65644 25563 65655 34216 72222 55557 55552 55775 55255 55222 71247"
_DIGITS = "75557 26227 71747 71717 55711 74717 74757 71111 75757 75717"
_ROWS = dict(zip("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789", f"{_LETTERS} {_DIGITS}".split(), strict=True)) | {" ": "00000"}


def pattern(name: str, count: int, spacing_m: float) -> list[Point]:
    """Return the places of a pattern [m], centred at 0, 0.

    Args:
        name: line, square, ring, letters:TEXT (letters alone is a T), or a file with a line `x y` [m] for each place.
        count: Number of places of a line, square or ring.
        spacing_m: Distance of neighbouring places [m].

    Raises:
        ConfigError: The pattern is not known, the file cannot be read, a square cannot have that number, or a character
            has no form.
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
    if name.partition(":")[0] == "letters" and not Path(name).is_file():
        return _spelled(name.partition(":")[2] or "T", spacing_m)
    try:
        lines = read_regular(Path(name), _LARGEST_BYTES).decode().splitlines()
    except UnicodeDecodeError as error:
        raise ConfigError(f"--pattern {name}: is not text; a line is x and y in m, such as 1e-6 0") from error
    except OSError as error:
        names = ", ".join(NAMES)
        raise ConfigError(
            f"--pattern {name}: is not one of {names}, and cannot be read as a file: {error.strerror}"
        ) from error
    places = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            x, y = (float(word) for word in words)
            if not math.isfinite(x + y):
                raise ValueError
        except ValueError as error:
            raise ConfigError(f"--pattern {name}, line {number}: must be x and y in m, such as 1e-6 0") from error
        places.append((x, y))
    if not places:
        raise ConfigError(f"--pattern {name}: has no places; a line is x and y in m, such as 1e-6 0")
    return places


def _spelled(text: str, spacing_m: float) -> list[Point]:
    """Return the places of the dots of a word [m], centred at 0, 0."""
    for letter in text.upper():
        if letter not in _ROWS:
            raise ConfigError(f"--pattern letters:{text}: {letter!r} is not one of A to Z, 0 to 9 and space")
    middle = 0.5 * (4 * len(text) - 2)
    places = [
        ((4 * number + column - middle) * spacing_m, (2 - row) * spacing_m)
        for number, letter in enumerate(text.upper())
        for row, bits in enumerate(_ROWS[letter])
        for column in range(3)
        if int(bits) >> (2 - column) & 1
    ]
    if not places:
        raise ConfigError(f"--pattern letters:{text}: has no places; letters:T has seven")
    return places

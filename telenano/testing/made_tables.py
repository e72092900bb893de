"""A table of what became of files that a generator makes, by the kind of file: the program of such a generator.

print_table(__doc__, KINDS, outcome, {"read": count_read, "wrong": count_wrong}, reason=lambda one: one.reason)
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

_Outcome = TypeVar("_Outcome")
_MOST_REASONS, _LONGEST_REASON = 5, 160


def print_table(
    about: str | None,
    kinds: Sequence[Callable[..., Any]],
    outcome: Callable[[Any, int, Path], _Outcome],
    columns: Mapping[str, Callable[[list[_Outcome]], object]],
    *,
    reason: Callable[[_Outcome], str],
    fault: Callable[[_Outcome], str],
    note: Callable[[Any], str] = lambda kind: "",
) -> dict[str, list[_Outcome]]:
    """Make files of each kind that the command line names, print a row for each kind, and return the outcomes by kind.

    Args:
        about: The description of the program in its help.
        kinds: Functions that make a file of a kind; their names stand in the rows and are the choices of `--kind`.
        outcome: Makes the file of a kind and a seed in a folder, and returns the result of reading it.
        columns: Functions of all outcomes of a kind, by the heading of their column.
        reason: Returns the reason why a file was refused, empty if it was read; `--reasons` prints different reasons.
        fault: Returns the fault of an outcome, empty if there is none; `--reasons` prints it with the seed.
        note: Returns a remark on a kind, which stands behind its name.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=50, metavar="COUNT", help="files of each kind")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first seed")
    parser.add_argument("--kind", nargs="*", choices=[kind.__name__ for kind in kinds], metavar="NAME")
    parser.add_argument("--reasons", action="store_true", help="print why files were refused, and what was wrong")
    chosen = parser.parse_args()
    write = sys.stdout.write
    write(f"| kind | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}\n")
    made: dict[str, list[_Outcome]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for kind in kinds:
            name = kind.__name__
            if chosen.kind and name not in chosen.kind:
                continue
            found = made[name] = [outcome(kind, chosen.first + seed, Path(folder)) for seed in range(chosen.count)]
            write(f"| {name}{note(kind)} | {' | '.join(str(cell(found)) for cell in columns.values())} |\n")
            if chosen.reasons:
                texts = {reason(one)[-_LONGEST_REASON:].replace("\n", " ") for one in found if reason(one)}
                write("".join(f"    {text}\n" for text in sorted(texts)[:_MOST_REASONS]))
                faults = [(chosen.first + seed, fault(one)) for seed, one in enumerate(found)]
                write("".join(f"    seed {seed}: {text}\n" for seed, text in faults if text))
            sys.stdout.flush()
    return made

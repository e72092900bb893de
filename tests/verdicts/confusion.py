"""Compare what the judge says of the courses with their truth.

    python tests/verdicts/confusion.py --courses all --seeds 0:3000
    python tests/verdicts/confusion.py --courses kinds --seeds 0:200

The courses are those of `courses.py` (linear), of `nonlinear.py`, both, all of `kinds.py`, or one kind of these. Prints
the table truth by kind, the shares that have a limit with Wilson's intervals, the same by tag and by cell, and the
seeds of the wrong answers; of `kinds.py` a line for each kind. Ends with 1 where a share is above its limit. The judge
is `judge_course` of `judge.py` in this folder.
"""

import argparse
import functools
import importlib
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, Protocol

import distribution as d
import nonlinear_distribution as n
from courses import Course, course
from kinds import CLASSES, KINDS, kind_course
from nonlinear import nonlinear_course

from telenano.analysis.intervals import wilson

# What each kind says of the motion of the loop. A kind that is renamed is renamed here, and nowhere else in this file.
FAMILIES = {
    "stable": "quiet",
    "settling": "quiet",
    "limit_cycle": "cycle",
    "diverged": "growth",
    "cannot_say": "open",
    "no_data": "open",
    "guarded": "guarded",
    "contact_lost": "left",
}
SAYS_NOTHING = "open"  # The family of the kinds that leave open what the loop does.
RIGHT = {"settles": {"quiet"}, "goes_on": {"cycle"}, "grows": {"growth", "guarded", "left"}}  # The families that agree.
COURSES: dict[str, tuple[Callable[[int], Course], ...]] = {
    "linear": (course,),
    "nonlinear": (nonlinear_course,),
    "all": (course, nonlinear_course),
    **{name: (functools.partial(kind_course, name),) for name in KINDS},
    "kinds": tuple(functools.partial(kind_course, name) for name in KINDS),
}
MOST_SEEDS = 40  # Seeds printed of one kind of wrong answer; the count before them is of all.


class Judge(Protocol):
    """What `judge.py` offers as `judge_course`."""

    def __call__(self, course: Course, /) -> tuple[str, str]:
        """Return the kind of a verdict, a key of FAMILIES, and its reason in a sentence."""
        ...


class Answer(NamedTuple):
    """What the judge said of one course, beside what is true."""

    seed: int
    truth: str
    kind: str
    family: str
    reason: str
    cell: str
    tags: frozenset[str]


class Share(NamedTuple):
    """How many answers of a class are such, and at most which share of them may be."""

    name: str
    such: list[int]  # Their seeds.
    of: int
    limit: float | None

    @property
    def value(self) -> float:
        return len(self.such) / self.of if self.of else 0.0

    @property
    def too_large(self) -> bool:
        return self.limit is not None and self.value > self.limit


def sealed(recorded: Course) -> Course:
    """Return a course without its truth and all that belongs to it, as the judge receives it."""
    return recorded._replace(truth="no_truth", rate_per_s=0.0, frequency_hz=0.0, tags=frozenset(), cell="", seed=0)


def answer(judge: Judge, recorded: Course) -> Answer:
    """Return what a judge says of a course.

    Without a withdrawal in the recording "guarded" says nothing of the loop, and counts as such.

    Raises:
        ValueError: the judge named a kind that FAMILIES does not have.
    """
    kind, reason = judge(sealed(recorded))
    if kind not in FAMILIES:
        raise ValueError(f"course {recorded.seed}: the judge says {kind!r}, and not one of {', '.join(FAMILIES)}")
    family = FAMILIES[kind]
    if family == "guarded" and recorded.guard is None:
        family = SAYS_NOTHING
    return Answer(recorded.seed, recorded.truth, kind, family, reason, recorded.cell, recorded.tags)


def share(name: str, answers: Iterable[Answer], such: Callable[[Answer], bool], limit: float | None = None) -> Share:
    """Return the share of answers that are such."""
    listed = list(answers)
    return Share(name, [one.seed for one in listed if such(one)], len(listed), limit)


def known(answers: Iterable[Answer]) -> list[Answer]:
    """Return the answers on courses that have a truth."""
    return [one for one in answers if one.truth in RIGHT]


def false_alarm(one: Answer) -> bool:
    return one.truth == "settles" and one.family in ("cycle", "growth")


def missed_swing(one: Answer) -> bool:
    return one.truth in ("grows", "goes_on") and one.family == "quiet"


def says_nothing(one: Answer) -> bool:
    return one.family == SAYS_NOTHING


def cells(answers: Iterable[Answer]) -> dict[str, list[Answer]]:
    """Return the answers on courses with a truth by cell; cells with few courses are one cell together."""
    found: dict[str, list[Answer]] = defaultdict(list)
    for one in known(answers):
        found[one.cell].append(one)
    few = [cell for cell, there in found.items() if len(there) < d.LEAST_IN_A_CELL]
    rare = [one for cell in few for one in found.pop(cell)]
    return dict(sorted(found.items())) | ({"all rare cells": rare} if rare else {})


def limited_shares(answers: list[Answer]) -> list[Share]:
    """Return every share that has a limit."""
    of_truth = {truth: [one for one in answers if one.truth == truth] for truth in RIGHT}
    return [
        share("settling called a cycle or growth", of_truth["settles"], false_alarm, d.MOST_FALSE_ALARMS),
        share(
            "growing or going on called stable",
            [*of_truth["grows"], *of_truth["goes_on"]],
            missed_swing,
            n.MOST_STABLE_ALTHOUGH_IT_SWINGS,
        ),
        share("cannot say", known(answers), says_nothing, d.MOST_CANNOT_SAY),
        share(
            "cannot say of what is at rest",
            [one for one in known(answers) if "at_rest" in one.tags],
            says_nothing,
            n.MOST_OPEN_OF_RESTS,
        ),
        share(
            "cannot say of a growth or cycle of four turns",
            [one for one in known(answers) if "many_turns" in one.tags],
            says_nothing,
            n.MOST_OPEN_OF_FOUR_TURNS,
        ),
        share("cannot say without a reason", filter(says_nothing, answers), lambda one: not one.reason.strip(), 0.0),
        *(
            share(f"cannot say in {cell}", there, says_nothing, d.MOST_CANNOT_SAY_IN_A_CELL)
            for cell, there in cells(answers).items()
        ),
    ]


def other_shares(answers: list[Answer]) -> list[Share]:
    """Return the other wrong answers, which have no limit of their own."""
    of_truth = {truth: [one for one in answers if one.truth == truth] for truth in RIGHT}
    return [
        share("growing called stable", of_truth["grows"], missed_swing),
        share("cycle called stable", of_truth["goes_on"], missed_swing),
        share("cycle called growth", of_truth["goes_on"], lambda one: one.family in ("growth", "guarded")),
        share("growing called a cycle", of_truth["grows"], lambda one: one.family == "cycle"),
        share("settling called guarded", of_truth["settles"], lambda one: one.family == "guarded"),
    ]


def _table(answers: list[Answer]) -> Iterator[str]:
    """Give the lines of the table truth by kind."""
    counts = Counter((one.truth, one.kind) for one in answers)
    yield f"{'truth':12}{'courses':>9}" + "".join(f"{kind:>13}" for kind in FAMILIES)
    for truth in (*RIGHT, "no_truth"):
        row = [counts[truth, kind] for kind in FAMILIES]
        yield f"{truth:12}{sum(row):>9}" + "".join(f"{count:>13}" for count in row)


def _line(one: Share) -> str:
    limit = "" if one.limit is None else f" (at most {one.limit:.1%}){' ABOVE ITS LIMIT' if one.too_large else ''}"
    low, high = wilson(len(one.such), one.of)
    return f"{one.name:46}{len(one.such):>6} of {one.of:<6}{one.value:7.2%} ({low:.2%} to {high:.2%}){limit}"


def _seeds(one: Share) -> str:
    more = " ..." if len(one.such) > MOST_SEEDS else ""
    return f"  {one.name}, {len(one.such)}: {' '.join(map(str, one.such[:MOST_SEEDS]))}{more}"


def _by_tag(answers: list[Answer]) -> Iterator[str]:
    """Give a line for each tag: its courses with a truth, wrong answers and how many of them are left open."""
    yield f"{'tag':18}{'courses':>9}{'false alarms':>15}{'called stable':>15}{'other wrong':>13}{'cannot say':>12}"
    there = known(answers)
    for tag in sorted({tag for one in there for tag in one.tags}):
        tagged = [one for one in there if tag in one.tags]
        alarms, missed = sum(map(false_alarm, tagged)), sum(map(missed_swing, tagged))
        open_ = sum(map(says_nothing, tagged))
        wrong = sum(one.family not in RIGHT[one.truth] for one in tagged) - alarms - missed - open_
        yield f"{tag:18}{len(tagged):>9}{alarms:>15}{missed:>15}{wrong:>13}{open_ / len(tagged):>12.1%}"


def _without_truth(answers: list[Answer]) -> Iterator[str]:
    """Give a line for each rule by which a course has no truth, with the kinds said of its courses."""
    rules: dict[str, Counter[str]] = defaultdict(Counter)
    for one in answers:
        for tag in one.tags:
            if tag.startswith("no_truth:"):
                rules[tag][one.kind] += 1
    for rule, kinds in sorted(rules.items()):
        said = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
        yield f"{rule:28}{sum(kinds.values()):>6}: {said}"


def by_kind(answers: list[Answer]) -> Iterator[str]:
    """Give a line for each kind of `kinds.py` and each class of them: what was said, and Wilson's intervals."""
    yield f"{'kind':24}{'courses':>8}{'stable':>7}{'cycle':>7}{'growth':>7}{'open':>7}  wrong, and cannot say"
    for one, kinds in CLASSES.items():
        for name in (*kinds, one):
            there = [own for own in answers if name in own.tags]
            counts = Counter(own.family for own in there)
            wrong = sum(false_alarm(own) or missed_swing(own) for own in there)
            intervals = [wilson(count, len(there)) for count in (wrong, counts[SAYS_NOTHING])] if there else []
            words = ", ".join(f"{low:.1%} to {high:.1%}" for low, high in intervals)
            row = "".join(f"{counts[family]:>7}" for family in ("quiet", "cycle", "growth", SAYS_NOTHING))
            yield f"{('all ' if name == one else '') + name:24}{len(there):>8}{row}  {words}"
        yield ""


def report(answers: list[Answer]) -> Iterator[str]:
    """Give the lines of the whole comparison."""
    if any(own.cell.partition("/")[0] in CLASSES for own in answers):
        yield from by_kind(answers)
    limited, others = limited_shares(answers), other_shares(answers)
    yield from _table(answers)
    yield ""
    yield from map(_line, limited + others)
    yield from ("", "Seeds of the wrong answers:")
    yield from (_seeds(one) for one in limited[:2] + limited[3:4] + others if one.such)
    yield from ("", "By tag, of the courses that have a truth:")
    yield from _by_tag(answers)
    yield from ("", "Courses without a truth, by the rule:")
    yield from _without_truth(answers)


def _judge() -> Judge:
    """Return the judge; it is imported when it is needed, so that the courses can be read without it."""
    try:
        judge: Judge = importlib.import_module("judge").judge_course
    except ModuleNotFoundError as error:
        if error.name != "judge":
            raise
        sys.exit("There is no judge.py in tests/verdicts: it has to offer judge_course(course) -> (kind, reason).")
    return judge


def _range(text: str) -> range:
    first, _, last = text.partition(":")
    try:
        seeds = range(int(first), int(last))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not FIRST:END, such as 0:{d.COURSES}") from None
    if not seeds or seeds[0] < 0:
        raise argparse.ArgumentTypeError(f"{text!r} has no seed; FIRST is zero or more and smaller than END")
    return seeds


def main(arguments: list[str] | None = None, judge: Judge | None = None) -> int:
    """Print the comparison; return 1 where a share is above its limit, else 0."""
    parser = argparse.ArgumentParser(description="Compare what the judge says of the labelled courses with their truth")
    parser.add_argument("--seeds", type=_range, default=range(d.COURSES), help=f"FIRST:END, 0:{d.COURSES} if not given")
    parser.add_argument("--courses", choices=COURSES, default="all", help="which courses (default: %(default)s)")
    given = parser.parse_args(arguments)
    used = judge or _judge()
    answers = [answer(used, make(seed)) for make in COURSES[given.courses] for seed in given.seeds]
    sys.stdout.writelines(f"{line}\n" for line in report(answers))
    return int(any(one.too_large for one in limited_shares(answers)))


if __name__ == "__main__":
    sys.exit(main())

"""The page of a trial as Markdown, made from the file alone, so that it is the same everywhere."""

import warnings

from telenano_devices.acceptance.take import LOADS
from telenano_devices.acceptance.trial.trial_file import Trial, kind_of, lines_of

_WORDS = {"pass": "passed", "fail": "**failed**", "retake": "to be made again", "cannot say": "cannot say"}


def sheet_of(trial: Trial) -> str:
    """Return the page of a trial as Markdown."""
    acceptance, driver = trial.acceptance, _cell(trial.acceptance.driver)
    text = [
        f"# Trial of {_cell(acceptance.device) or driver}: {_word(acceptance.result)}",
        "",
        f"Driver `{driver}`, {acceptance.seconds:.0f} s of motion. The tolerances are provisional.",
    ]
    for load in dict.fromkeys((*LOADS, *(line.load for line in acceptance.lines))):
        if lines := [line for line in acceptance.lines if line.load == load]:
            text += [
                "",
                f"## {_cell(load.capitalize())}",
                "",
                "| check | result | found | wanted |",
                "|---|---|---|---|",
            ]
            text += [
                f"| {_cell(line.check)} | {_word(line.result)} | {_cell(line.found)} | {_cell(line.wanted)} |"
                for line in lines
            ]
    text += ["", "## Errors", ""]
    text += [f"- {_cell(each.where)}: {_cell(each.text)}" + _places(each.places) for each in trial.errors] or ["None."]
    text += [
        "",
        "## Versions",
        "",
        ", ".join(_cell(f"{name} {number}") for name, number in trial.versions.items()) + ".",
    ]
    return "\n".join(text) + "\n"


def judged_again(trial: Trial) -> list[str]:
    """Return the checks whose result changes when the version here judges the recording, one sentence each.

    If a check fails on impossible values in the recording, the list holds one sentence that says so.
    """
    if trial.take is None:
        return []
    before = {line.check: line.result for line in trial.acceptance.lines}
    try:
        with warnings.catch_warnings(action="ignore"):
            now = lines_of(kind_of(trial.take), trial.take)
    except Exception as error:  # noqa: BLE001
        return [f"the recording in it cannot be judged ({type(error).__name__}: {_cell(str(error))[:200]})"]
    return [
        f"{line.check}: {line.result} here, {before.get(line.check, 'not judged')} in the file"
        for line in now
        if before.get(line.check) != line.result
    ]


def _word(result: str) -> str:
    return _WORDS.get(result) or _cell(result)


def _places(places: list[str]) -> str:
    return f" ({_cell(' > '.join(places))})" if places else ""


def _cell(text: str) -> str:
    """Return a text for a cell of Markdown, without control characters and without backquotes, which end code spans."""
    plain = "".join(letter for letter in " ".join(text.split()) if letter.isprintable())
    return plain.replace("|", "\\|").replace("`", "'")

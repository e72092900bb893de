"""A trial whose file is whole, and whose values are not those of a device: a page or a sentence, no traceback."""

import json
import random
import time
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from telenano_devices.acceptance.trial.sheet import judged_again, sheet_of
from telenano_devices.acceptance.trial.trial_file import read_trial, write_trial
from test_device_trial import led, simulated_trial

from telenano.wire import ConfigError

TIMES = 50
# The memory is measured for this number of files, because that takes time.
SIZED = 10
STRANGE = (0, -1, 1e308, -1e308, 1 << 63, "", "x\x1b[2J`id`", None, [], {}, [[]], True, 1e-320, [0] * 40, {"a": 1})
NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e308, 5e-324)


def places(value: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the ways to all parts of a document."""
    found = [way] if way else []
    if isinstance(value, dict | list):
        keys = value if isinstance(value, dict) else range(len(value))
        for key in keys:
            found += places(value[key], (*way, key))
    return found


def spoilt(document: Any, draw: random.Random) -> Any:
    """Return a document of which a part or two are something else, or are gone."""
    document = json.loads(json.dumps(document))
    for _ in range(draw.randint(1, 2)):
        ways = places(document)
        if not ways:
            return draw.choice(STRANGE)
        way = draw.choice(ways)
        parent = document
        for key in way[:-1]:
            parent = parent[key] if isinstance(parent, dict | list) and len(parent) else {}
        if isinstance(parent, dict) and way[-1] in parent and draw.random() < 0.2:
            del parent[way[-1]]
        elif isinstance(parent, dict) or (isinstance(parent, list) and way[-1] < len(parent)):
            parent[way[-1]] = draw.choice(STRANGE)
    return document


def spoilt_rows(rows: Any, draw: random.Random) -> Any:
    """Return rows of which a column, or some, are what no device says."""
    rows = rows.copy()
    for _ in range(draw.randint(1, 3)):
        name = draw.choice(rows.dtype.names)
        column = rows[name]
        begin = draw.randrange(len(rows)) if draw.random() < 0.7 else 0
        if column.dtype.kind == "f":
            column[begin : begin + draw.choice((1, 50, len(rows)))] = draw.choice(NUMBERS)
        else:
            column[begin:] = np.zeros((), column.dtype) if draw.random() < 0.5 else column[0]
    return rows[: draw.randint(1, len(rows))] if draw.random() < 0.3 else rows


def test_strange_values_in_a_whole_file_end_in_a_page_or_in_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "trial.zip"
    trial = simulated_trial({}, led({"slow": "end"}))
    assert trial.take is not None
    write_trial(path, trial)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    (tmp_path / "take.npz").write_bytes(members["take.npz"])
    with np.load(tmp_path / "take.npz") as arrays:
        rows, facts = arrays["rows"], json.loads(str(arrays["facts"]))
    texts = {name: json.loads(members[name]) for name in members if name.endswith(".json")}

    def read() -> float:
        begun_s = time.process_time()
        try:
            found = read_trial(path)
            assert sheet_of(found).replace("\n", " ").isprintable()
            said.append(judged_again(found))
        except ConfigError as error:
            assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
            said.append([str(error)])
        return time.process_time() - begun_s

    said: list[list[str]] = []
    sound_s, strange_s = [], []
    sound = path.read_bytes()
    for number in range(TIMES):
        # Each case is drawn by itself: the documents have what is installed here, and so other places to spoil.
        draw = random.Random(f"8 {number}")
        path.write_bytes(sound)
        sound_s.append(read())
        assert said.pop() == []
        others, kind = dict(texts), draw.random()
        if kind < 0.3:
            name = draw.choice(sorted(others))
            others[name] = spoilt(others[name], draw)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, document in others.items():
                archive.writestr(name, json.dumps(document))
            with archive.open("take.npz", "w") as file:
                np.savez(
                    file,
                    rows=spoilt_rows(rows, draw) if kind > 0.6 else rows,
                    facts=json.dumps(spoilt(facts, draw) if 0.3 <= kind <= 0.6 else facts),
                )
        if number < SIZED:
            tracemalloc.start()
            read()
            assert tracemalloc.get_traced_memory()[1] < (200 << 20) + 10 * path.stat().st_size
            tracemalloc.stop()
        else:
            strange_s.append(read())
    assert np.sum(strange_s) < 3.0 * np.mean(sound_s) * len(strange_s)
    refused = [texts[0] for texts in said if texts and texts[0].startswith(str(path))]
    unjudged = [texts[0] for texts in said if texts and texts[0].startswith("the recording in it cannot be judged")]
    assert 0 < len(refused) < TIMES / 2 and 0 < len(unjudged) < TIMES / 2

"""The notebooks of docs/notebooks, which are stored with the outputs of their cells.

`python tests/doubles/kept_notebooks.py [TABLES]` runs them and writes their outputs again; look at the pictures before
you commit them. TABLES is the folder `analysis` of an experiment; without it the experiment is run first.
`tests/examples/test_notebooks.py` compares the stored outputs with a fresh run.
"""

import base64
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
# Environment variables with the inputs of a notebook; without the second, it reads the recording of telenano.
_EXPERIMENT, _RECORDING = "TELENANO_EXPERIMENT", "TELENANO_RECORDING"
_COLOURS = 64  # of a kept picture
_LONGEST_S = 280.0  # of an experiment or a notebook

Document = dict[str, Any]


def experiment_in(folder: Path) -> Path:
    """Run the experiment of the documentation in simulated time, and return the folder of its tables."""
    out = folder / "experiment"
    telenano = [sys.executable, "-m", "telenano", "experiment"]
    for words in (["run", "delay_and_law", "--apparatus", "lockstep", "--out", str(out)], ["analyse", str(out)]):
        subprocess.run([*telenano, *words], cwd=ROOT, check=True, stdout=subprocess.DEVNULL, timeout=_LONGEST_S)
    return out / "analysis"


def executed(path: Path, folder: Path, experiment: Path) -> Document:
    """Run a copy of a notebook in a folder and return it with its outputs.

    Raises:
        RuntimeError: A cell fails; the message has the output of nbconvert.
    """
    environment = {name: value for name, value in os.environ.items() if name not in ("MPLBACKEND", _RECORDING)}
    environment[_EXPERIMENT] = str(experiment.resolve())
    shutil.copy(path, folder)
    # The kernel communicates over sockets of the user, which are created in the folder in which it is started.
    command = [sys.executable, "-m", "nbconvert", "--to", "notebook", "--execute", "--inplace", path.name]
    command += ["--KernelManager.transport=ipc", f"--ExecutePreprocessor.startup_timeout={_LONGEST_S:.0f}"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=_LONGEST_S)
    if done.returncode:
        raise RuntimeError(f"{path.name}: {done.stderr}")
    return document_of(folder / path.name)


def document_of(path: Path) -> Document:
    found: Document = json.loads(path.read_text(encoding="utf-8"))
    return found


def text_of(cell: Document) -> str:
    """Return the printed text and the shown result of a cell, without pictures."""
    shown = [output.get("text", output.get("data", {}).get("text/plain", "")) for output in cell.get("outputs", ())]
    return "".join(part for text in shown for part in text)


def pictures_of(cell: Document) -> list[bytes]:
    """Return the pictures of a cell as PNG."""
    drawn = [output.get("data", {}).get("image/png", "") for output in cell.get("outputs", ())]
    return [base64.b64decode(text) for text in drawn if text]


def keep(path: Path, made: Document) -> None:
    """Write the outputs of a run into a notebook: with small pictures, without times and facts on the machine."""
    document = document_of(path)
    for cell, ran in zip(document["cells"], made["cells"], strict=True):
        if cell["cell_type"] == "code":
            cell["outputs"] = _joined([_small(output) for output in ran["outputs"]])
            cell["execution_count"] = ran["execution_count"]
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _small(output: Document) -> Document:
    if text := output.get("data", {}).get("image/png"):
        png = io.BytesIO()
        picture = Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")
        picture.quantize(_COLOURS).save(png, format="png", optimize=True)
        output["data"]["image/png"] = base64.b64encode(png.getvalue()).decode()
    return output


def _joined(outputs: list[Document]) -> list[Document]:
    """Join successive outputs of a stream, whose division depends on timing."""
    joined: list[Document] = []
    for output in outputs:
        if joined and output.get("name") and output.get("name") == joined[-1].get("name"):
            joined[-1]["text"] = [*joined[-1]["text"], *output["text"]]
        else:
            joined.append(output)
    return joined


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        experiment = Path(sys.argv[1]) if len(sys.argv) > 1 else experiment_in(Path(name))
        for path in NOTEBOOKS:
            keep(path, executed(path, Path(name), experiment))


if __name__ == "__main__":
    main()

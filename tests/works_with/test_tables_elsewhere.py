"""Tables of a recording in programs that analyse data: every digit of position and force, gaps, flags and texts."""

import json
from pathlib import Path

import numpy as np
import pytest
from foreign_programs import debian_program, python_program
from made_recording import WANTED, recording_in
from planted_errors import Numbers, each_error, judge

from telenano.recording import export_recording
from telenano.testing import EPOCH_NS

pytestmark = pytest.mark.timeout(1800)

DUCKDB = """
import duckdb, json, sys
def columns(path):
    table = duckdb.sql(f"select * from '{path}' order by seq")
    return dict(zip(table.columns, zip(*table.fetchall())))
hand, forward = (columns(path) for path in sys.argv[1:])
print(json.dumps({
    "position": list(zip(*(hand[f"position_m.{each}"] for each in range(3)))),
    "force": list(zip(*(hand[f"operator_force_n.{each}"] for each in range(3)))),
    "limited": hand["limited"],
    "late_ns": [int(each) - BEGUN for each in hand["t_ns"]],
    "energy": [float("nan") if each is None else float(each) for each in forward["energy_j"]],
}))
"""

OCTAVE = """
function found = column(path, name)
  file = fopen(path);
  at = find(strcmp(strsplit(fgetl(file), ","), name));
  found = [];
  while ischar(line = fgetl(file))
    field = strsplit(line, ",", "CollapseDelimiters", false){at};
    if any(strcmp(field, {"True", "False"}))
      found(end + 1, 1) = strcmp(field, "True");
    elseif strcmp(name, "t_ns")
      found(end + 1, 1) = double(str2num(["int64(" field ")"]) - int64(BEGUN));
    else
      found(end + 1, 1) = str2double(field);
    end
  end
  fclose(file);
end
[hand, forward] = argv(){:};
three = @(name) [column(hand, [name ".0"]) column(hand, [name ".1"]) column(hand, [name ".2"])];
show = @(name, values) printf("%s %s\\n", name, sprintf("%.17g ", values'));
show("position", three("position_m"));
show("force", three("operator_force_n"));
show("limited", column(hand, "limited"));
show("late_ns", column(hand, "t_ns"));
show("energy", column(forward, "energy_j"));
"""

R = """
paths <- commandArgs(trailingOnly = TRUE)
read <- function(path) read.csv(path, check.names = FALSE, colClasses = c(t_ns = "character"))
hand <- read(paths[1]); forward <- read(paths[2])
show <- function(name, values) cat(name, formatC(values, digits = 17), "\\n")
three <- function(name) c(t(as.matrix(hand[paste(name, 0:2, sep = ".")])))
show("position", three("position_m"))
show("force", three("operator_force_n"))
show("limited", as.numeric(hand$limited == "True"))
show("late_ns", as.numeric(substring(hand$t_ns, 11)))
show("energy", as.numeric(forward$energy_j))
"""


def exported(folder: Path, kind: str, error: str) -> tuple[Path, Path]:
    """Return the files of the tables of a recording."""
    export_recording(recording_in(folder, error), folder / kind, kind)
    return folder / kind / f"haptic_state.{kind}", folder / kind / f"teleop_forward.{kind}"


def shown(printed: str) -> Numbers:
    """Return what a program prints as a line for each quantity: its name, then its numbers; remarks are left out."""
    rows = [line.split() for line in printed.splitlines() if line.strip()]
    found = {
        name: np.array([float(word.replace("NA", "nan")) for word in words]) for name, *words in rows if name in WANTED
    }
    return {name: values.reshape(np.shape(WANTED[name])) for name, values in found.items()}


@each_error
@pytest.mark.check("installs DuckDB")
def test_duckdb_reads_parquet(tmp_path: Path, error: str) -> None:
    duckdb = python_program("duckdb==2.0.1")
    found = duckdb.run("-c", DUCKDB.replace("BEGUN", str(EPOCH_NS)), *exported(tmp_path, "parquet", error))
    judge(error, WANTED, json.loads(found), rtol=0.0)


@each_error
@pytest.mark.endurance
def test_octave_reads_csv(tmp_path: Path, error: str) -> None:
    octave = debian_program("usr/bin/octave-cli", "octave")
    octave = octave.having(OCTAVE_HOME=octave.folder / "usr", HOME=tmp_path)
    script = tmp_path / "read_tables.m"
    script.write_text(f"1;\n{OCTAVE.replace('BEGUN', str(EPOCH_NS))}")
    found = octave.run("--no-init-file", "--norc", script, *exported(tmp_path, "csv", error))
    judge(error, WANTED, shown(found), rtol=0.0)


@each_error
@pytest.mark.endurance
def test_r_reads_csv(tmp_path: Path, error: str) -> None:
    r = debian_program("usr/lib/R/bin/exec/R", "r-base-core")
    # The files of the system that name these lie elsewhere here.
    r = r.having(R_HOME=r.folder / "usr/lib/R", EDITOR="vi", PAGER="cat")
    script = tmp_path / "read_tables.r"
    script.write_text(R)
    found = r.run("--vanilla", "--no-echo", f"--file={script}", "--args", *exported(tmp_path, "csv", error))
    judge(error, WANTED, shown(found), rtol=0.0)

"""The options of commands, other values of them, and what a person sees of a command: exit code, output and files.

A command is run twice as it is; what differs between the two runs, such as a time of the day, is not compared. Another
value has to be a valid one: that a command refuses it is an effect only of the options of which refusing is the point.
Each command has a row in `COMMANDS`, or its reason in `OF_A_RIG`.
"""

import functools
import json
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import command_lines
import given_files
import pytest
from compared_sessions import facts_of
from mcap.exceptions import McapError
from typer.testing import CliRunner

from telenano.cli.root import app
from telenano.recording.reader import Recording
from telenano.settings import DEMO_RECORDING

# A recording stands for `{demo}`, a folder to work in for `{out}`; `given_files.py` makes what other names stand for.
SHORT = "--duration 0.6 --set realtime.rate_hz=250"
COMMANDS: Mapping[str, str] = {
    "simulate": f"simulate fig12 {SHORT} --out {{out}}",
    "report": "report {demo} --out {out}",
    "bag info": "bag info {demo}",
    "bag list": "bag list {folder}",
    "bag cat": "bag cat {demo} --topics link/status",
    "bag filter": "bag filter {demo} --out {out}/made.mcap",
    "bag split": "bag split {demo} --out {out} --interval 1",
    "bag verify": "bag verify {demo}",
    "bag recover": "bag recover {demo} --out {out}/made.mcap",
    "bag export": "bag export {demo} --out {out}/made.mcap --to mcap-json",
    "bag rerun": "bag rerun {demo} --node controller@master",
    "bag diff": "bag diff {demo} {demo}",
    "link report": "link report {demo}",
    "link picture": "link picture lte --out {out}",
    "scenario show": "scenario show fig12",
    "scenario check": "scenario check fig12",
    "scenario new": "scenario new mine --out {out}/mine.yaml",
    "scenario schema": "scenario schema",
    "param list": "param list",
    "param get": "param get haptic_node.operator.kind",
    "topic info": "topic info afm/state",
    "law list": "law list",
    "law show": "law show wave",
    "new": "new law my_law --out {out}/made",
    "bag merge": "bag merge --same-session {parts} --out {out}/made.mcap",
    "link fit": "link fit {log} --out {out} --anyway",
    "scan": "scan --pixels 4 --lines 4 --out {out}",
    "bag plot": "bag plot {demo} afm/state.tip_force_n --out {out}/made.png",
    "compare": "compare {demo} {parts} --out {out}",
    "study stability": "study stability --environment spring --law virtual_impedance --delay 0,20 --stiffness 20"
    " --duration 3 --workers 1 --out {out}",
    "study transparency": "study transparency --law wave --delay 10 --stiffness 20 --frequency 1,10 --workers 1"
    " --out {out}",
    "study gallery": "study gallery --out {out}",
    "study promises": "study promises --law wave --seeds 1 --burst 5 --workers 1 --out {out}",
    "study push": "study push --law wave --delay 10 --seeds 1 --workers 1 --out {out}",
    "study advise": "study advise --delay 20 --seeds 1 --workers 1 --out {out}",
    "study drift": "study drift --law wave --speed 10 --time-constant 5 --seeds 1 --workers 1 --out {out}",
    "benchmark": "benchmark --quick --law wave --network clean --instrument ideal --hand scripted"
    " --workers 1 --out {out}",
    "reproduce": "reproduce fig8 --pixels 8 --out {out}",
    "bag recalibrate": "bag recalibrate {raw} --handle {handle} --out {out}/made.mcap",
    "budget": "budget {demo} --out {out}",
    "scenario list": "scenario list",
    "law check": "law check wave",
    "law balance": "law balance wave --cases 1 --longest 5 --kind hold",
    "link profile": "link profile lte --show",
    "keys new": "keys new other --dir {out}",
    "keys show": "keys show --dir {out}",
    "keys allow": "keys allow slave {key} --role data --dir {out}",
    "keys revoke": "keys revoke slave --dir {out}",
    "device list": "device list",
    "device probe": "device probe --device simulated_impedance",
    "device accept": "device accept --independent-stop switch --out {out}",
    "device trial": "device trial simulated_impedance --yes --independent-stop switch --out {out}/trial",
    "doctor": "doctor",
    "experiment new": "experiment new mine --out {out}/mine.yaml",
    "experiment check": "experiment check {experiment}",
    "experiment plan": "experiment plan delay_and_law --effect 0.5 --spread 0.25",
    "experiment run": "experiment run {experiment} --out {out}/run",
    "experiment resume": "experiment resume {out}/run",
    "experiment status": "experiment status {done}",
    "experiment analyse": "experiment analyse {study} --measure completion_time_s --out {out}",
    "experiment publish": "experiment publish {study} --out {out}/published.zip",
    "experiment erase": "experiment erase {out}/study P01 --yes",
    "experiment people add": "experiment people add {out}/study P09",
    "experiment people exclude": "experiment people exclude {out}/study P01 --reason tired",
    "experiment people list": "experiment people list {out}/study",
    "particles": "particles {image} --size 3000",
    "push": "push --from 0,0 --to 100,0",
    "assemble": "assemble --pattern line --count 1 --out {out}",
    "sample import": "sample import {curve} --set stiffness_n_per_m=2 --out {out}/map.npz",
    "sample": "sample --out {out}",
    "sample info": "sample info {map}",
    "curve": "curve --points 60 --out {out}",
    "curve fit": "curve fit {curve} --model hertz --radius 30 --set stiffness_n_per_m=2 --out {out}/table.csv",
    "calibrate sensitivity": "calibrate sensitivity --curve {hard}",
    "calibrate stiffness": "calibrate stiffness --spectrum {spectrum} --sensitivity 60",
    "inspect": "inspect {curve}",
}
_CELL = "benchmark cell --law wave --network clean --draw 2 --workers 1"
_OVERLAID = COMMANDS["curve"] + " --overlay {curve} --set stiffness_n_per_m=2"
# Words with which an option acts that does nothing, or is refused, with those of its command.
ACTS: Mapping[str, str] = {
    "bag split --size": "bag split {demo} --out {out} --size 400000",
    "new --node": "new device my_handle --out {out}/made",
    "simulate --overwrite": COMMANDS["simulate"],
    "simulate --table": COMMANDS["simulate"] + " --seeds 2",
    "bag diff --topics": "bag diff {raw} {again}",
    "bag diff --exclude": "bag diff {raw} {again}",
    "bag diff --tolerance": "bag diff {raw} {again}",
    "bag diff --ignore": "bag diff {raw} {again}",
    "keys new --replace": "keys new slave --dir {out}",
    "calibrate stiffness --anyway": "calibrate stiffness --spectrum {spectrum} --sensitivity 60 --frequency-unit kHz",
    "calibrate stiffness --size-error": COMMANDS["calibrate stiffness"] + " --size 30e3 225e3",
    "calibrate stiffness --spectrum": "calibrate stiffness --record {record} --rate 1e6 --sensitivity 60",
    "calibrate stiffness --record": "calibrate stiffness --rate 1e6 --sensitivity 60",
    "calibrate stiffness --rate": "calibrate stiffness --record {record} --rate 1e6 --sensitivity 60",
    "calibrate sensitivity --anyway": "calibrate sensitivity --curve {hard} --deflection-unit mV",
    "curve fit --half-angle": "curve fit {cone} --model sneddon --half-angle 20 --set stiffness_n_per_m=2"
    " --out {out}/table.csv",
    "curve fit --most-refused": "curve fit {flat} --model hertz --radius 30 --set stiffness_n_per_m=2"
    " --out {out}/table.csv",
    **{f"benchmark {option}": _CELL for option in ("--task", "--arm", "--seed", "--draw", "--draw-seed")},
    "study advise --network": "study advise --network wifi --seeds 1 --workers 1 --out {out}",
    "assemble --spacing": "assemble --pattern line --count 2 --out {out}",
    "curve --set": _OVERLAID,
    "curve --number": _OVERLAID,
    "curve --reduced-modulus": _OVERLAID,
    "experiment erase --yes": "experiment erase {out}/study P01",
    "law balance --longest": "law balance position_force --cases 4 --longest 5 --kind off --json",
    "device accept --from": "device accept --out {out}",
}
# What is run first, in the emptied folder, by command, or by command and option.
BEFORE: Mapping[str, Sequence[str]] = {
    "simulate --overwrite": (COMMANDS["simulate"],),
    "keys new --replace": ("keys new slave --dir {out}",),
    "keys show": ("keys allow slave {key} --role data --dir {out}",),
    "keys revoke": ("keys allow slave {key} --role data --dir {out}",),
    "experiment resume": ("experiment run {experiment} --out {out}/run --participant P01",),
    "experiment people list": ("experiment people add {out}/study P09",),
    "device accept --from": ("device accept --independent-stop switch --mass 0.1 --out {out}/before",),
}
# Of a recording that is not larger the messages are compared, and not only how many there are.
SMALL_BYTES = 100_000
# Commands that take minutes for all of their values, left to `make endurance`.
COSTLY = (
    "assemble", "benchmark", "study advise", "study drift", "study gallery", "study promises", "study push",
    "study stability",
)  # fmt: skip
# Commands that take three to six seconds for each value: not drawn for `make check`, but tried where they are touched.
SLOW = ("compare", "device accept", "link picture", "report", "reproduce", "scan", "simulate", "study transparency")
# Commands that are not tried, each with the reason.
OF_A_RIG: Mapping[str, str] = {
    "up": "starts processes, whose times differ; `simulate` has most of its options, and tests/stack the others",
    "session": "commands a running rig; tests/stack/test_running_rig.py and tests/unit/console",
    "estop": "stops a running rig; tests/stack/test_estop_kept.py and tests/unit/console",
    "status": "listens to a running rig; tests/stack/test_running_rig.py",
    "view": "serves until it is ended; tests/unit/viz_node/test_view_command.py",
    "bridge foxglove": "serves a running rig until it is ended; packages/telenano-bridges",
    "bridge lsl": "serves a running rig until it is ended; packages/telenano-bridges",
    "bridge ros2": "serves a running rig until it is ended; packages/telenano-bridges",
    "topic list": "listens to a running rig; tests/stack/test_running_rig.py",
    "topic echo": "listens to a running rig; tests/stack/test_running_rig.py",
    "topic hz": "listens to a running rig; tests/stack/test_running_rig.py",
    "topic pub": "commands a running rig; tests/stack/test_running_rig.py",
    "link show": "asks a running rig; tests/stack/test_running_rig.py",
    "link set": "changes a running rig; tests/stack/test_running_rig.py",
    "link clear": "changes a running rig; tests/stack/test_running_rig.py",
    "link udp": "carries datagrams of other programs; packages/telenano-lab/tests/networks/test_udp_link.py",
    "link probe": "measures the line of a running rig; tests/stack/test_wide_area.py",
    "node": "is a process of a rig, and has no options",
    "record": "records a running rig; tests/stack and tests/unit/recorder",
    "replay": "plays into a running rig; tests/stack/test_replay_into_rig.py and tests/unit/player",
    "gateway": "serves pages and joins rigs until it is ended; tests/stack/test_gateway_page.py",
    "relay": "forwards what two sites send until it is ended; tests/stack/test_relay.py",
    "law by-line": "changes the law of a running rig; packages/telenano-laws/tests/test_by_line.py",
    "conformance": "examines a running client; tests/unit/testing/test_conformance.py",
    "device simulate handle": "serves until it is ended; packages/telenano-devices",
    "device simulate t7": "serves until it is ended; packages/telenano-devices",
    "device simulate haply": "serves until it is ended; packages/telenano-devices",
    "device simulate gwyscope": "serves until it is ended; packages/telenano-devices",
    "device simulate nanonis": "serves until it is ended; packages/telenano-devices",
    "device guard gwyscope": "serves until it is ended; packages/telenano-devices/tests/controllers",
    "device guard nanonis": "serves until it is ended; packages/telenano-devices/tests/controllers",
    "device approach": "moves an instrument that is connected; packages/telenano-devices/tests/controllers",
    "device monitor": "watches a device that is connected; packages/telenano-devices",
    "device calibrate stage": "reads an instrument that is connected; packages/telenano-devices/tests/t7",
    "device calibrate handle": "reads a handle that is connected; packages/telenano-devices/tests/handle",
    "bag fetch": "reads from the recorder of another machine; tests/stack/test_fetched_recording.py",
    "study validate": "starts a rig for each cell; tests/stack and the tests of the package of studies",
    "study network": "reads what `link probe` has measured on a rig; the tests of the package of studies",
}
# Valid other values of options, by command and option, or by option alone; of a flag the words beside it that it needs.
VALUES: Mapping[str, Sequence[str]] = {
    "--instrument": ["real"],
    "--round-trip-ms": ["30"],
    "--duration": ["1.5", "0.7"],
    "--set": [
        "controller.law=wave",
        "afm_node.tip_sample.tip_radius_m=2e-8",
        "rate_hz=500",
        "controller.force_scale=2e8",
    ],
    "--seed": ["5"],
    "--at": ["'0.1 mark * text=here'", "'0.1 estop *'"],
    "--sweep": ["controller.law=wave,passivity"],
    "--seeds": ["2"],
    "--topics": ["afm/state"],
    "--exclude": ["afm/state", "link/*"],
    "--nodes": ["afm_node@slave"],
    "--start": ["1.0"],
    "--end": ["1.0"],
    "--count": ["3"],
    "--interval": ["0.7"],
    "--size": ["200000"],
    "--to": ["csv", "mcap-protobuf", "parquet"],
    "bag rerun --node": ["afm_node@slave"],
    "new --node": ["afm_node"],
    "--topic": ["afm/state"],
    "--from": ["touch"],
    "--scenario": ["touch"],
    "curve --points": ["80"],
    "curve --start": ["30"],
    "curve --load": ["30"],
    "curve --speed": ["80"],
    "curve --afm": ["cantilever.stiffness_n_per_m=10"],
    "curve --overlay": ["{curve} --set stiffness_n_per_m=2"],
    "curve --set": ["stiffness_n_per_m=3"],
    "curve --reduced-modulus": ["1e9"],
    "sample --sample": ["grating"],
    "sample --size": ["200"],
    "sample --set": ["dot_count=20"],
    "sample --tip-radius": ["20"],
    "sample --align-rows": ["median"],
    "sample --mask-above": ["1 --align-rows median"],
    "sample --mask-below": ["1 --align-rows median"],
    "--format": ["svg", "pdf"],
    "--style": ["paper"],
    "--table": ["parquet", "csv"],
    "--law": ["passivity"],
    "--delay": ["10", "30"],
    "--loss": ["20%"],
    "--jitter": ["5"],
    "--stiffness": ["30"],
    "--frequency": ["2,20"],
    "param get --set": ["haptic_node.operator.kind=interactive"],
    "scan --mode": ["contact"],
    "scan --x": ["10"],
    "scan --y": ["10"],
    "scan --pixels": ["6"],
    "scan --lines": ["3"],
    "scan --dwell": ["8"],
    "scan --amplitude": ["30"],
    "scan --gain": ["200"],
    "scan --proportional": ["0.1"],
    "scan --approach": ["50"],
    "scan --settle": ["100"],
    "scan --sample": ["grating"],
    "scan --size": ["200"],
    "scan --set": ["dot_count=20"],
    "scan --setpoint": ["0.7"],
    "scan --temperature": ["300"],
    "scan --noise-seed": ["3 --temperature 300"],
    "scan --align-rows": ["median"],
    "scan --mask-above": ["1 --align-rows median"],
    "scan --mask-below": ["1 --align-rows median"],
    "scan --afm": ["cantilever.stiffness_n_per_m=10"],
    "link fit --about": ["'a line of a test'"],
    "link fit --cite": ["'nobody'"],
    "study push --seeds": ["2"],
    "study push --law": ["passivity"],
    "study push --delay": ["200"],
    "study promises --burst": ["20"],
    "study advise --network": ["lte"],
    "study advise --instrument": ["ideal"],
    "study advise --sample": ["soft"],
    "study stability --gain": ["12"],
    "study stability --hand": ["stiff"],
    "study transparency --hand": ["stiff"],
    "study stability --environment": ["wall"],
    "study stability --disturb": ["thermal.enabled=true", "drift.enabled=true", "readout.enabled=true"],
    "study stability --set": ["clamp.enabled=true"],
    "study stability --duration": ["4"],
    "study stability --seed": ["5 --jitter 5"],
    "study stability --seeds": ["2 --jitter 5"],
    "study transparency --draws": ["2"],
    "study transparency --set": ["clamp.enabled=true"],
    "study drift --speed": ["50"],
    "study drift --time-constant": ["20"],
    "study drift --law": ["passivity"],
    "study drift --network": ["lte"],
    "benchmark --law": ["passivity"],
    "benchmark --network": ["lte"],
    "benchmark --instrument": ["real"],
    "benchmark --hand": ["trembling"],
    "benchmark --task": ["hold", "touch"],
    "benchmark --arm": ["soft", "stiff"],
    "benchmark --seed": ["1", "0"],
    "benchmark --draw": ["3"],
    "benchmark --draw-seed": ["7"],
    "benchmark --set": ["wave.mass_kg=1.0", "wave.force_scale=2e8"],
    "reproduce --pixels": ["9"],
    "bag recalibrate --handle": ["{other_handle}"],
    "bag recalibrate --stage": ["{stage}"],
    "bag diff --topics": ["afm/state"],
    "bag diff --exclude": ["haptic/state"],
    "bag diff --tolerance": ["position_m=1"],
    "bag diff --ignore": ["position_m"],
    "budget --handle": ["{handle}"],
    "budget --stage": ["{stage}"],
    "--expires": ["2099-06-30"],
    "law balance --longest": ["20"],
    "law balance --kind": ["off"],
    "law balance --seed": ["2"],
    "law balance --cases": ["2"],
    "--dir": ["{elsewhere}"],
    "keys allow --role": ["observe"],
    "device probe --device": ["haply"],
    "device probe --set": ["haptic_node.coupling.margin=2"],
    "device accept --set": ["haptic_node.coupling.margin=2"],
    "device trial --set": ["haptic_node.coupling.margin=2"],
    "--mass": ["0.1"],
    "--independent-stop": ["pedal"],
    "device accept --device": ["haply"],
    "device accept --calibration": ["{stage}"],
    "device trial --calibration": ["{stage}"],
    "device probe --calibration": ["{stage}"],
    "--port": ["/dev/nowhere"],
    "device accept --from": ["{out}/before/take.npz"],
    "device accept --fault": ["scale=2.0"],
    "doctor --stage": ["{stage}"],
    "experiment new --from": ["delay_and_law"],
    "experiment run --participant": ["P02"],
    "experiment resume --participant": ["P01"],
    "experiment analyse --measure": ["force_error_n"],
    "experiment analyse --category": ["delay_ms"],
    "experiment plan --category": ["round_trip_ms"],
    "experiment analyse --within": ["law"],
    "experiment analyse --correction": ["none", "bonferroni"],
    "experiment analyse --confidence": ["0.9"],
    "experiment plan --effect": ["1.0"],
    "experiment plan --spread": ["0.5"],
    "experiment plan --power": ["0.9"],
    "--handedness": ["left"],
    "--reason": ["late"],
    "particles --size": ["2000"],
    "particles --tip-radius": ["20"],
    "particles --cone": ["30"],
    "push --from": ["10,0"],
    "push --to": ["200,0"],
    "push --mode": ["steered", "sweep"],
    "push --radius": ["200"],
    "push --tip-radius": ["20"],
    "push --cone-deg": ["30"],
    "push --hold": ["force"],
    "push --height": ["20"],
    "push --setpoint": ["20"],
    "push --speed": ["1000"],
    "push --approach": ["1000"],
    "push --lateral-limit": ["5"],
    "push --tolerance": ["20"],
    "push --gain": ["200 --hold force"],
    "push --pitch": ["0.3 --mode sweep"],
    "push --stop-on-loss": ["--to 2000,500", ""],
    "push --afm": ["friction.coefficient=0.3", "cantilever.stiffness_n_per_m=2"],
    "assemble --pattern": ["ring", "square --count 4"],
    "assemble --count": ["2"],
    "assemble --spacing": ["1500"],
    "assemble --afm": ["friction.coefficient=0.3", "cantilever.stiffness_n_per_m=2"],
    "sample import --set": ["stiffness_n_per_m=3"],
    "sample import --points": ["50"],
    "sample import --correct": ["offset"],
    "sample import --baseline": ["30 --correct offset"],
    "sample import --as": ["force"],
    "sample info --set": ["stiffness_n_per_m=3"],
    "curve fit --model": ["dmt", "jkr"],
    "curve fit --radius": ["20"],
    "curve fit --half-angle": ["30"],
    "curve fit --poisson": ["0.3"],
    "curve fit --thickness": ["500"],
    "curve fit --most-refused": ["1"],
    "curve fit --set": ["stiffness_n_per_m=3"],
    "calibrate sensitivity --curve": ["{other_hard}"],
    "calibrate sensitivity --part": ["0.4 0.8"],
    "calibrate sensitivity --way-unit": ["um --anyway"],
    "calibrate sensitivity --deflection-unit": ["mV --anyway"],
    "--columns": ["2 1"],
    "--figure": ["{out}/made.png"],
    "calibrate stiffness --temperature": ["310"],
    "calibrate stiffness --spectrum": ["{spectrum}"],
    "calibrate stiffness --record": ["{record}"],
    "calibrate stiffness --unit": ["V/sqrt(Hz)"],
    "calibrate stiffness --sides": ["two", "both", "2"],
    "calibrate stiffness --noise-bandwidth": ["100"],
    "calibrate stiffness --frequency-unit": ["kHz --anyway"],
    "calibrate stiffness --exclude": ["69.9e3 70.1e3"],
    "calibrate stiffness --sensitivity": ["50"],
    "calibrate stiffness --sensitivity-error": ["2"],
    "calibrate stiffness --rate": ["9e5"],
    "calibrate stiffness --averages": ["20"],
    "calibrate stiffness --factor": ["0.9"],
    "calibrate stiffness --size": ["30e3 225e3"],
    "calibrate stiffness --size-error": ["1e3"],
    "inspect --set": ["way_unit=um"],
}
# Options that a command refuses in these circumstances, because what is read there does not need them, and the reason.
REFUSES: Mapping[str, str] = {
    "scan --channel": "the sample is not a file",
    "sample --channel": "the sample is not a file",
    "curve --number": "a curve in a text is one",
    "study transparency --hand": "an arm would travel further than a hand may at these frequencies",
    "study push --quick": "the words give a number of trials",
    "study stability --mass": "a spring has none",
    "study stability --body-damping": "a spring has none",
    "calibrate sensitivity --columns": "the other order is that of no curve",
    "calibrate stiffness --noise-bandwidth": "the file has a density",
    "calibrate stiffness --columns": "the other order is that of no spectrum",
    "calibrate stiffness --unit": "a density in another unit has no resonance",
    "calibrate stiffness --spectrum": "a record is given as well",
    "keys revoke --dir": "in the other folder no key is allowed",
    "device probe --device": "no such device is connected",
    "device probe --port": "no handle is connected",
    "device probe --calibration": "the instrument is not connected",
    "device accept --device": "no such device is connected",
    "device accept --calibration": "the instrument is not connected",
    "device trial --calibration": "a device for the hand is tried",
    "device trial --port": "no handle is connected",
    "sample import --channel": "a curve in a text has no channels",
    "particles --channel": "a table of numbers has no channels",
    "sample info --channel": "a map has no channels",
    "sample import --as": "the curve is one of force",
    "link fit --unit": "the headings of the log name their units",
    "link fit --direction": "the log is not a recording",
    "link fit --period": "the log has times",
    "link fit --taken": "no source is cited",
    "link fit --histogram": "the log is not a histogram; packages/telenano-lab has one",
}
# Options without an effect in these circumstances, each with the reason.
WITHOUT: Mapping[str, str] = {
    "--out": "is where the files are",
    "--same-session": "acts on several files; tests/unit/recording/test_session_identity.py",
    "--jobs": "is how many processes compute; the result is the same",
    "--scheduler": "needs a cluster; the tests of the package of studies",
    "compare --published": "is a file of a published curve; packages/telenano-lab",
    "--live": "needs a running rig; tests/stack/test_live_programs.py",
    "--site-file": "is where a running rig is; tests/stack",
    "--rig": "is which running rig is meant; tests/stack",
    "--allow-code": "acts on a scenario that names code; tests/unit/cli",
    "bag info --full": "acts on a long recording; tests/unit/recording",
    "device probe --baud": "is of a handle that is connected; packages/telenano-devices/tests/handle",
    "device trial --read": "reads the file of a trial; packages/telenano-devices/tests/acceptance/test_device_trial.py",
    "doctor --warm": "compiles all models, which takes minutes; tests/unit/doctor",
    "experiment publish --recordings": "a lockstep records nothing; test_experiment_publish.py",
    "experiment run --apparatus": "a live one starts a rig for each participant; tests/stack/test_experiments.py",
    "experiment run --marks": "writes on a port that is connected; test_experiment_marks.py",
    "experiment run --baud": "is of a port that is connected; test_experiment_marks.py",
    "experiment resume --marks": "writes on a port that is connected; test_experiment_marks.py",
    "experiment resume --baud": "is of a port that is connected; test_experiment_marks.py",
    "sample import --level": "acts where a map has several curves; test_recorded_map.py",
    "bag rerun --tolerance": "the re-run gives the same bits; tests/replay/test_rerun.py",
}


@dataclass
class Seen:
    """What a command leaves: exit code, lines of its output and of its messages, and its files.

    They are told apart, because the messages of a bar of progress are as many as the machine is slow.
    """

    code: int
    lines: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    files: dict[str, Any] = field(default_factory=dict)

    def items(self) -> Iterator[tuple[str, Any]]:
        """Yield what is compared, by its name."""
        yield "exit code", self.code
        yield "number of lines", len(self.lines)
        yield from ((f"line {number}", line) for number, line in enumerate(self.lines))
        yield "number of messages", len(self.messages)
        yield from ((f"message {number}", line) for number, line in enumerate(self.messages))
        yield "files", sorted(self.files)
        yield from ((f"content of {name}", content) for name, content in self.files.items())


def run(words: Sequence[str], folder: Path, ready: Callable[[], None] = lambda: None) -> Seen:
    """Run a command in a folder that has what is made ready there, and nothing else.

    A sweep repeats the words of its own process. An exception is what no person may see, and so no effect.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    ready()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["telenano", *words])
        result = CliRunner().invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise AssertionError(f"{shlex.join(words)} ends with a traceback") from result.exception
    output, messages = (
        re.sub(r"[0-9.]+ (s|ms|kB|MB)\b", "", text).splitlines() for text in (result.stdout, result.stderr)
    )
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and ".tmp" not in path.name]
    files = {str(path.relative_to(folder)): content_of(path) for path in paths}
    return Seen(result.exit_code, output, messages, files)


def content_of(path: Path) -> Any:
    """Return what is compared of a file."""
    if path.suffix == ".mcap":
        try:
            facts = facts_of(path)
        except (AssertionError, McapError):  # A file that is not complete is compared by its bytes.
            return path.read_bytes()
        return facts, list(Recording(path).raw()) if path.stat().st_size < SMALL_BYTES else []
    if path.suffix == ".json":
        return flat(json.loads(path.read_text("utf-8")))
    if path.suffix in (".key", ".key_secret"):
        # Each run draws keys.
        return re.sub(r"-key = .*", "", path.read_text("utf-8"))
    if path.suffix in (".html", ".svg", ".yaml"):
        return re.sub(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?)?", "", path.read_text("utf-8"))
    return path.read_bytes()


def flat(value: Any, stem: str = "") -> dict[str, Any]:
    """Return the leaves of a document without what only repeats how it was made."""
    if isinstance(value, Mapping):
        parts = [flat(inner, f"{stem}.{key}") for key, inner in value.items() if key not in ("provenance", "settings")]
        return {name: leaf for part in parts for name, leaf in part.items()}
    return {stem: value}


def commands() -> Iterator[tuple[str, Any]]:
    """Yield the name of each command and the command."""
    return ((" ".join(words), command) for words, command in command_lines.commands())


def values_of(command: str, option: Any) -> list[list[str]]:
    """Return the words of an option with other values."""
    flag = option.opts[0]
    known = VALUES.get(f"{command} {flag}", VALUES.get(flag))
    if option.is_flag:
        return [[flag, *shlex.split(value)] for value in known or [""]]
    return [[flag, *shlex.split(str(value))] for value in (known or choices_of(option) or ["2", "0.5", "1"])]


def choices_of(option: Any) -> list[str]:
    """Return the values of an option that has one of several, else none."""
    kind = option.type_descriptor.annotation
    if isinstance(kind, type) and issubclass(kind, Enum):
        return [str(member.value) for member in kind]
    return list(map(str, get_args(kind))) if get_origin(kind) is Literal else []


def words_of(command: str, folder: Path, flag: str = "") -> list[str]:
    """Return the words of a command as it is, or those in which one of its options acts."""
    return filled(ACTS.get(f"{command} {flag}", COMMANDS[command]), folder)


def filled(words: str, folder: Path) -> list[str]:
    """Return the words of a command with the files that stand for their names."""
    return shlex.split(words.format(demo=DEMO_RECORDING, out=folder / "out", **given_files.given(folder)))


def ready(command: str, flag: str, folder: Path) -> Callable[[], None]:
    """Return what makes what the folder has before a command: what others leave there, and a study to change."""
    name = f"{command} {flag}"
    earlier = BEFORE.get(name, BEFORE.get(command, ()))
    has_study = "{out}/study" in ACTS.get(name, COMMANDS[command])

    def make() -> None:
        if has_study:
            shutil.copytree(given_files.given(folder)["study"], folder / "out" / "study")
        for words in earlier:
            done = CliRunner().invoke(app, filled(words, folder))
            assert done.exit_code == 0, f"{words}: {done.output}"

    return make


@functools.lru_cache(maxsize=2)
def as_it_is(command: str, flag: str, folder: Path) -> tuple[dict[str, Any], frozenset[str]]:
    """Return what a command leaves as it is, and the names of what is the same in a second run."""
    words, make = words_of(command, folder, flag), ready(command, flag, folder)
    first, second = (dict(run(words, folder / "out", make).items()) for _ in range(2))
    # 3: the model of a line is not like its log. What an option acts upon may be what is refused without it.
    assert flag or first["exit code"] in (0, 3), f"{command}: {first}"
    return first, frozenset(name for name in first if first[name] == second.get(name))


def _place_of(words: list[str], more: list[str]) -> int | None:
    """Return where words give an option already, or for one that states keys the same key; None if nowhere."""
    key = more[1].partition("=")[0] + "=" if more[0] in ("--set", "--afm") else ""
    places = [place for place, word in enumerate(words) if word == more[0]]
    return next((place for place in places if not key or words[place + 1].startswith(key)), None)


def effect_of(command: str, option: Any, folder: Path) -> str:
    """Return what a valid other value of an option changes, empty if that is nothing."""
    name = f"{command} {option.opts[0]}"
    flag = option.opts[0] if name in ACTS or name in BEFORE else ""
    words, make = words_of(command, folder, flag), ready(command, flag, folder)
    first, stable = as_it_is(command, flag, folder)
    for more in values_of(command, option):
        more = [filled(word, folder)[0] if "{" in word else word for word in more]
        tried = [*words, *more]
        if option.is_flag and more[0] in words:
            tried = [word for word in words if word != more[0]]
        elif (place := _place_of(words, more)) is not None:
            tried = [*words[:place], *words[place + 1 + option.nargs :], *more]
        found = run(tried, folder / "out", make)
        if found.code == 2 and name not in REFUSES:
            continue
        now = dict(found.items())
        changed = [one for one in stable if now.get(one) != first[one]]
        if changed:
            return sorted(changed)[0]
    return ""

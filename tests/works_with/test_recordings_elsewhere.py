"""Recordings in readers of MCAP that telenano does not use: those of Node, and that of the viewer Rerun."""

import json
from pathlib import Path

import pytest
from foreign_programs import node_program, python_program
from made_recording import WANTED, recording_in
from planted_errors import each_error, judge

from telenano.recording import export_recording
from telenano.testing import EPOCH_NS

pytestmark = [pytest.mark.timeout(1800), pytest.mark.endurance]

MCAP = """
import { createRequire } from "node:module";
import { open } from "node:fs/promises";
const installed = createRequire(`${process.env.READER_PACKAGES}/`);
const { McapIndexedReader } = installed("@mcap/core");
const { FileHandleReadable } = installed("@mcap/nodejs");
const { loadDecompressHandlers } = installed("@mcap/support");
const { decode } = installed("@msgpack/msgpack");
const [path, form] = process.argv.slice(2);
const readable = new FileHandleReadable(await open(path, "r"));
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
const read = form === "json" ? (data) => JSON.parse(new TextDecoder().decode(data)) : (data) => decode(data);
const found = { position: [], force: [], limited: [], late_ns: [], energy: [] };
for await (const message of reader.readMessages()) {
  const { topic } = reader.channelsById.get(message.channelId);
  const fields = read(message.data);
  if (topic === "haptic/state") {
    found.position.push(fields.position_m);
    found.force.push(fields.operator_force_n);
    found.limited.push(fields.limited);
    found.late_ns.push(Number(message.publishTime - BEGUNn));
  } else if (topic === "teleop/forward") found.energy.push(fields.energy_j ?? null);
}
console.log(JSON.stringify(found));
"""


@pytest.mark.parametrize("form", ["msgpack", "json"])
@each_error
def test_node_reads_a_recording(tmp_path: Path, form: str, error: str) -> None:
    packages = ("@mcap/core@2.2.2", "@mcap/nodejs@1.0.2", "@mcap/support@1.1.0", "@msgpack/msgpack@3.1.3")
    node = node_program(*packages)
    path, script = recording_in(tmp_path, error), tmp_path / "read.mjs"
    if form == "json":
        export_recording(path, tmp_path / "viewer.mcap", "mcap-json")
        path = tmp_path / "viewer.mcap"
    script.write_text(MCAP.replace("BEGUN", str(EPOCH_NS)), encoding="utf-8")
    found = json.loads(node.having(READER_PACKAGES=node.folder).run(script, path, form))
    judge(error, WANTED, found, rtol=0.0)


RERUN = """
import json, sys
from rerun.chunk import McapReader
messages = {}
for chunk in McapReader(sys.argv[1]).stream():
    rows = chunk.to_record_batch()
    for name in rows.schema.names:
        if name.endswith(":message"):
            messages.setdefault(chunk.entity_path, []).extend(cell[0] for cell in rows.column(name).to_pylist())
hand, forward = messages["/haptic/state"], messages["/teleop/forward"]
print(json.dumps({
    "position": [each["position_m"] for each in hand],
    "force": [each["operator_force_n"] for each in hand],
    "limited": [each["limited"] for each in hand],
    "late_ns": [each["t_ns"] - BEGUN for each in hand],
    "energy": [each["energy_j"] for each in forward],
}))
"""


@each_error
def test_rerun_reads_what_is_exported_for_it(tmp_path: Path, error: str) -> None:
    rerun = python_program("rerun-sdk==0.41.0").having(HOME=tmp_path)
    # It would report its use elsewhere.
    rerun.run("-m", "rerun", "analytics", "disable")
    export_recording(recording_in(tmp_path, error), tmp_path / "viewer.mcap", "protobuf")
    found = rerun.run("-c", RERUN.replace("BEGUN", str(EPOCH_NS)), tmp_path / "viewer.mcap")
    judge(error, WANTED, json.loads(found), rtol=0.0)

"""What stands between backticks in a sentence is taken for a command: no text of a file of somebody else is put there.

Each value that a sentence puts between backticks is in this table, with where it comes from.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
_ROOMS = ("services", "telenano", "packages")

_MAYBE = re.compile(r"`[^`]{0,200}\{")

OWN, NAMED, QUOTED, PLAIN = (
    "a constant of the project",
    "what the person who runs the command has named, or a name that a pattern has checked",
    "quoted for the shell",
    "Markdown of a result, in which the words between backticks are no command",
)
ORIGINS = {
    "telenano/analysis/summary.py: name": PLAIN,
    "telenano/analysis/summary.py: word": PLAIN,
    "telenano/link/models/traces.py: wanted": OWN,
    "telenano/link/profiles.py: shlex.quote(name)": QUOTED,
    "telenano/launcher/run.py: again": QUOTED,
    "telenano/launcher/run.py: names": QUOTED,
    "telenano/launcher/run.py: plan.out": NAMED,
    "telenano/launcher/run.py: plan.site_file": NAMED,
    "telenano/launcher/session.py: arm": OWN,
    "telenano/launcher/session.py: at": OWN,
    "services/player/plan.py: others": NAMED,
    "packages/telenano-wide-area/telenano_wide_area/relay/protocol.py: RELAY": OWN,
    "telenano/recording/verify.py: how_to_add_package(package)": OWN,
    "telenano/runtime/security/keyring.py: name": NAMED,
    "telenano/runtime/security/keyring.py: option": OWN,
    "telenano/runtime/security/peer_connections.py: own.machine": NAMED,
    "telenano/runtime/security/peer_connections.py: own.public_key": NAMED,
    "telenano/runtime/security/peer_connections.py: self.machine": NAMED,
    "telenano/runtime/wiring/main.py: self.prog": OWN,
    "services/viz_node/build_page.py: ' '.join(step)": OWN,
    "telenano/cli/output.py: own_command()": NAMED,
    "telenano/cli/output.py: path": OWN,
    "telenano/cli/output.py: shlex.quote(recording)": QUOTED,
    "telenano/doctor/checks.py: demands[name]": OWN,
    "telenano/doctor/checks.py: name": OWN,
    "telenano/doctor/checks.py: unknown[0]": NAMED,
    "telenano/doctor/devices.py: _GOOD_LATENCY_MS": OWN,
    "telenano/doctor/devices.py: timer": OWN,
    "packages/telenano-acceptance/telenano_acceptance/trial/sheet.py: driver": PLAIN,
    "packages/telenano-afm-controllers/telenano_afm_controllers/request_driver.py: self.calibration.controller": NAMED,
    "packages/telenano-experiments/telenano_experiments/bus.py: line": OWN,
    "packages/telenano-experiments/telenano_experiments/experiment_command.py: folder": NAMED,
    "packages/telenano-experiments/telenano_experiments/table.py: level": PLAIN,
    "packages/telenano-experiments/telenano_experiments/table.py: row.name": PLAIN,
    "packages/telenano-networks/telenano_networks/publish.py: topic": NAMED,
    "packages/telenano-networks/telenano_networks/udp_command.py: keeper.path": NAMED,
}


def quoted_values(path: Path) -> Iterator[str]:
    """Yield the values that the sentences of a module put between backticks."""
    text = path.read_text(encoding="utf-8")
    # to parse all modules takes seconds
    for node in ast.walk(ast.parse(text)) if _MAYBE.search(text) else ():
        if isinstance(node, ast.JoinedStr):
            is_inside = False
            for part in node.values:
                if isinstance(part, ast.Constant):
                    is_inside ^= bool(str(part.value).count("`") % 2)
                elif is_inside and isinstance(part, ast.FormattedValue):
                    yield ast.unparse(part.value)


def test_every_value_between_backticks_has_an_origin() -> None:
    found = {
        f"{path.relative_to(ROOT)}: {value}"
        for room in _ROOMS
        for path in (ROOT / room).rglob("*.py")
        if "tests" not in path.relative_to(ROOT).parts
        for value in quoted_values(path)
    }
    assert found == set(ORIGINS)


def test_a_value_between_backticks_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("text = f'{a}: run `telenano {b} --out {c!r}`, or {d}'")
    assert list(quoted_values(tmp_path / "a.py")) == ["b", "c"]

"""Every way to command a rig or to push its hand, and what looks at the lease of the hand on it."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[3]
ROOMS = ("services", "telenano", "packages", "benchmarks")
# What makes a command or a force: a client on the bus, the client that holds the hand for a command, and a page's hand.
MAKERS = ("CommandClient", "command_client", "send_control", "send_controls", "arm_devices", "RigHand")

# Without a name of its page `send_control` takes the hand for the command, or looks whether the process still has it.
HOLDS = "send_control"
WAYS = {
    ("telenano/runtime/wiring/participant.py", "CommandClient"): "what calls command_client, and is listed here",
    ("telenano/console/command_client.py", "command_client"): "send_controls, which holds the hand around it",
    ("telenano/console/command_client.py", "send_controls by"): "the same, with the hand held",
    ("telenano/console/coupling.py", "send_control by"): "the hub's desk for a page; without a name send_control",
    ("packages/telenano-microscopy/telenano_microscopy/live_program.py", "send_control"): HOLDS,
    ("telenano/launcher/session.py", "CommandClient"): "the session: it arms at its beginning and stops at its end",
    (
        "packages/telenano-wide-area/telenano_wide_area/far_recording.py",
        "command_client",
    ): "a recorder that is asked for its file, and nothing moves",
    ("services/viz_node/commander.py", "send_control by"): "the hub's desk",
    ("services/viz_node/commander.py", "arm_devices by"): "the hub's desk",
    ("telenano/cli/commands/session.py", "arm_devices"): HOLDS,
    ("services/viz_node/node.py", "RigHand"): "the hub's desk",
    ("telenano/cli/commands/session.py", "send_control"): HOLDS,
    ("telenano/cli/estop_command.py", "send_control"): "nothing: an emergency stop asks nobody",
    ("packages/telenano-experiments/telenano_experiments/apparatus/live.py", "send_control"): HOLDS,
    ("packages/telenano-experiments/telenano_experiments/apparatus/page_hand.py", "RigHand"): "the experiment's hold",
    ("packages/telenano-laws/telenano_laws/by_line_command.py", "send_control"): HOLDS,
    ("packages/telenano-networks/telenano_networks/probe_command.py", "send_control"): HOLDS,
    ("benchmarks/estop.py", "send_control"): "nothing: an emergency stop asks nobody",
}


def calls(path: Path) -> set[str]:
    """Return which makers a module calls, and whether it gives the name of a page, which stands for its lease."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if name in MAKERS:
                names_page = any(keyword.arg == "by" for keyword in node.keywords)
                found.add(f"{name} by" if names_page else name)
    return found


def test_every_way_to_command_a_rig_looks_at_the_lease_and_is_named_here() -> None:
    found = {
        (str(path.relative_to(ROOT)), way)
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        if "tests" not in path.parts and "node_modules" not in path.parts
        for way in calls(path)
    }
    assert found == WAYS.keys()

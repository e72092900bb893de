"""What a session that failed says of itself."""

import json


def reason_of(stdout: str, stderr: str) -> str:
    """Return why a command with --json failed, in its own words."""
    try:
        return str(json.loads(stdout)["error"])
    except (ValueError, KeyError):
        return stderr.strip() or stdout.strip() or "no output"

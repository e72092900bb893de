"""Nothing that others rely on goes away without a release that has announced it; see docs/release.md."""

import json
import re

from public_surface import FILE, ROOT, surface

RULE = (ROOT / "docs" / "release.md").read_text(encoding="utf-8")


def announced() -> dict[str, str]:
    """Return the deprecated names of docs/release.md, each with the version that announced it."""
    table = RULE.partition("<!-- deprecated -->")[2].partition("<!-- end of deprecated -->")[0]
    return dict(re.findall(r"^\| `([^`]+)` \| ([0-9]+\.[0-9]+\.[0-9]+) \|", table, re.MULTILINE))


def test_every_public_name_is_still_there() -> None:
    pinned, now = json.loads(FILE.read_text(encoding="utf-8")), surface()
    gone = {f"{kind}: {name}" for kind, names in pinned.items() for name in names if name not in now[kind]}
    gone -= {f"{kind}: {name}" for kind in pinned for name in announced()}
    assert not gone, "announce it in docs/release.md first, or put it back"


def test_the_pin_has_something_of_every_kind() -> None:
    pinned = json.loads(FILE.read_text(encoding="utf-8"))
    assert pinned.keys() == surface().keys()
    assert all(len(names) >= 5 for names in pinned.values())
    assert "telenano.simulate" in pinned["python"]
    assert "telenano up --sweep" in pinned["options"]
    assert "delay_node.forward.jitter.scale_s" in pinned["scenario keys"]

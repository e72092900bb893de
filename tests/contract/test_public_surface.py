"""Nothing that others rely on goes away unnoticed; see docs/release.md."""

import json

from public_surface import FILE, surface


def test_every_public_name_is_still_there() -> None:
    pinned, now = json.loads(FILE.read_text(encoding="utf-8")), surface()
    gone = {f"{kind}: {name}" for kind, names in pinned.items() for name in names if name not in now[kind]}
    assert not gone, "put it back, or state it in CHANGELOG.md and write the file again (docs/release.md)"


def test_the_pin_has_something_of_every_kind() -> None:
    pinned = json.loads(FILE.read_text(encoding="utf-8"))
    assert pinned.keys() == surface().keys()
    assert all(len(names) >= 5 for names in pinned.values())
    assert "telenano.simulate" in pinned["python"]
    assert "telenano up --sweep" in pinned["options"]
    assert "delay_node.forward.jitter.scale_s" in pinned["scenario keys"]

"""The counts that a publisher gives at its end, from the event and back."""

from typing import Any

import pytest

from telenano.wire.ends import end_data, read_end


def event(**changes: Any) -> dict[str, Any]:
    data = end_data({"afm/state": 7, "session/event": 2}, {("teleop/forward", "controller@master"): 9})
    return {"src": "afm_node@slave", "kind": "node", "data": data, **changes}


def test_the_counts_come_back_by_topic_and_source() -> None:
    assert read_end(event()) == {
        ("afm/state", "afm_node@slave"): 7,
        ("session/event", "afm_node@slave"): 2,
        ("teleop/forward", "controller@master"): 9,
    }


@pytest.mark.parametrize(
    "changes",
    [{"kind": "fault"}, {"data": {}}, {"data": {"state": "started"}}, {"data": None}, {"kind": None}],
)
def test_any_other_event_is_none(changes: dict[str, Any]) -> None:
    assert read_end(event(**changes)) is None


@pytest.mark.parametrize("count", [-1, 2**63, 1.0, True, "7", None])
def test_what_is_no_count_is_left_out(count: Any) -> None:
    assert read_end(event(data={"state": "ended", "sent.afm/state": count, "sent": 3, "note": 4})) == {}

"""What `telenano.simulate` says of a law, an environment and a scenario that ship, `telenano up` says as well."""

from typing import Any

import pytest
from stack_rig import judged
from tried_laws import TRIED_LAWS

import telenano


def run(rig: Any, law: str, environment: str, scenario: str, *options: str) -> dict[str, Any]:
    found: dict[str, Any] = rig.run(
        "--set", f"controller.law={law}", "--set", f"afm_node.environment={environment}", *options, scenario=scenario
    )
    return found


@pytest.mark.endurance
@pytest.mark.parametrize("environment", ["tip_sample", "spring"])
@pytest.mark.parametrize("law", (*TRIED_LAWS, "tactile"))
def test_the_bus_gives_the_verdict_of_the_lockstep(rig: Any, law: str, environment: str) -> None:
    expected = telenano.simulate("fig12", law=law, environment=environment)
    summary = run(rig, law, environment, "fig12")
    agrees = summary["verdict"] == expected.verdict
    assert agrees or not judged(summary, f"{law} on {environment}"), summary["reason"]


@pytest.mark.endurance
@pytest.mark.parametrize("scenario", ["fig10", "touch", "image"])
def test_where_no_hand_presses_the_bus_says_so(rig: Any, scenario: str) -> None:
    summary = run(rig, "tactile" if scenario == "fig10" else "wave", "tip_sample", scenario, "--duration", "3")
    assert summary["verdict"] == "cannot_say"
    # The reason goes on with what a busy machine did to the session.
    assert summary["reason"].startswith("the hand pressed with no force, so there is no hold to judge")


@pytest.mark.endurance
def test_a_guard_on_the_bus_comes_first_with_time_and_limit(rig: Any) -> None:
    # the loop of 200 ms diverges on the spring of 20 N/m, whatever this machine adds
    summary = run(rig, "virtual_impedance", "spring", "fig12", "--round-trip-ms", "400")
    assert summary["verdict"] in ("diverged", "guarded")
    assert summary["reason"].startswith("the instrument's guard acted at ")
    assert "(force_limit: more than 200 nN on the tip)" in summary["reason"]

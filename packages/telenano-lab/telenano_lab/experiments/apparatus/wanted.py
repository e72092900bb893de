"""The settings of a running rig for a trial, and the keys that need another rig."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from telenano.sections import AfmConfig, ControllerConfig
from telenano.settings import LinkSettings, LoadedScenario, flatten
from telenano.wire import LinkDelay, Scalar
from telenano_lab.experiments.plan import changes_while_running

NO_HAND = {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}]}
_SIMULATED = ("simulated", "simulated_impedance")


class WantedSettings(NamedTuple):
    """The settings of a running rig: law, link, operator (as JSON) and disturbances, by key of `set`."""

    law: dict[str, Scalar]
    link: dict[str, Scalar]
    operator: str
    hand: dict[str, Scalar]
    tip: dict[str, Scalar]


def section_of(document: Mapping[str, Any], name: str, model: Any) -> Any:
    """Return a section of a scenario as its model."""
    loaded = LoadedScenario.of(document, "a trial")
    return loaded.section(name, model)


def kept_keys(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a scenario that a running rig does not accept: trials that differ in them need another rig."""
    flat = flatten({key: value for key, value in document.items() if key not in ("name", "description", "duration_s")})
    kept = {key: value for key, value in flat.items() if not changes_while_running(key)}
    # A hand at the page, of a person or of a program, cannot alternate with a simulated hand of the device.
    return {**kept, "interactive": flat.get("haptic_node.operator.kind") == "interactive"}


def wanted_of(document: Mapping[str, Any], seed: int) -> WantedSettings:
    """Return the settings of a running rig for a trial, defaults included, so that nothing of the last trial remains.

    Args:
        document: The scenario of the trial.
        seed: The seed of the link, if the scenario gives none.
    """
    law = flatten(section_of(document, "controller", ControllerConfig).model_dump(mode="json"))
    section = document.get("delay_node", {})
    link = section_of({**document, "delay_node": {"seed": seed, **section}}, "delay_node", LinkSettings).flattened(
        only_set=True
    )
    hand = document.get("haptic_node", {})
    operator = hand.get("operator", {})
    is_person = operator.get("kind") == "interactive" or hand.get("driver", "simulated") not in _SIMULATED
    disturbed = {name: document.get(name, {}).get("disturbances", {}) for name in ("haptic_node", "afm_node")}
    flat = {name: flatten({"disturbances": keys}) for name, keys in disturbed.items()}
    return WantedSettings(
        law={key: value for key, value in law.items() if key != "period_s" and _is_scalar(value)},
        link=dict(link),
        operator="" if is_person else json.dumps(operator or NO_HAND),
        hand={key: value for key, value in flat["haptic_node"].items() if _is_scalar(value)},
        tip={**{key: value for key, value in flat["afm_node"].items() if _is_scalar(value)}, **_spring(document)},
    )


def _spring(document: Mapping[str, Any]) -> dict[str, Scalar]:
    """Return the stiffness of a spring that replaces the sample, which a running rig accepts."""
    afm = section_of(document, "afm_node", AfmConfig)
    is_spring = afm.driver == "simulated" and afm.environment == "spring"
    return {"spring.stiffness_n_per_m": afm.spring.stiffness_n_per_m} if is_spring else {}


def _is_scalar(value: Any) -> bool:
    return isinstance(value, bool | int | float | str)


def of_way(link: Mapping[str, Scalar], way: str) -> dict[str, Scalar]:
    """Return the keys of one direction of the link, without its name."""
    return {key.removeprefix(f"{way}."): value for key, value in link.items() if key.startswith(f"{way}.")}


def constant_delays_ns(link: Mapping[str, Scalar]) -> dict[str, int]:
    """Return the delays that the link will report [ns], for the directions that have a fixed delay only."""
    delays_ns = {}
    for way in ("forward", "backward"):
        keys = {key for key, value in of_way(link, way).items() if value not in ("none", 0, 0.0, False)}
        if all(key in ("delay_s", "reliable") or key.startswith(("loss.", "corruption.")) for key in keys):
            delays_ns[way] = LinkDelay.reported_ns(round(1e9 * float(link.get(f"{way}.delay_s", 0.0))))
    return delays_ns

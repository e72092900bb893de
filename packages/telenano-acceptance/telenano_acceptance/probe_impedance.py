"""`telenano device probe` of a device that takes a force: what it declares, with its coupling and both bounds."""

from typing import Annotated, Any

import typer

KindOption = Annotated[
    str | None,
    typer.Option(
        "--device", metavar="DRIVER", help="Driver of a device: simulated_impedance, or one of an installed package."
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the device, such as haptic_node.coupling.margin."),
]
SIMULATED = "simulated_impedance"


def probe_impedance(kind: str, settings: list[str]) -> dict[str, Any]:
    """Open a device without force and return what it declares, with the coupling and its two bounds."""
    from services.haptic_node.config import HapticConfig
    from services.haptic_node.devices.servo_process import wire_of
    from services.runtime.settings.config import flag_overrides, validate

    chosen = flag_overrides([f"haptic_node.driver={kind}", *settings])
    config = validate(HapticConfig, chosen.get("haptic_node", {}), "--set", "haptic_node")
    if kind == SIMULATED:
        found = config.impedance.capabilities()
    else:
        section = getattr(config, kind)
        wire = wire_of(kind, {} if section is None else section.model_dump(mode="json"))
        try:
            found = wire.open()
        finally:
            wire.close()
    bounds = config.coupling.bounds(found)
    return {
        "identity": found.identity,
        "max_force_n": found.max_force_n,
        "declared_stiffness_n_per_m": found.max_stiffness_n_per_m,
        "declared_damping_n_s_per_m": found.max_damping_n_s_per_m,
        "workspace_m": f"{found.workspace_min_m:g} to {found.workspace_max_m:g} towards the sample",
        "servo_rate_hz": found.rate_hz,
        "drive_delay_s": found.drive_delay_s,
        "buttons": ", ".join(found.buttons),
        "coupling": bounds.sentence(),
        "coupling_stiffness_n_per_m": bounds.stiffness_n_per_m,
        "passive_bound_n_per_m": bounds.passive_n_per_m,
        "stable_bound_n_per_m": bounds.stable_n_per_m,
    }

"""The commands and the scenario of this package, which telenano lists without importing what they need."""

from pathlib import Path

SCENARIO = Path(__file__).with_name("assembly.yaml")
COMMANDS = {
    "particles": (
        "telenano_assembly.assemble_command:particles",
        "Find spheres in an image: places, radii and their errors.",
    ),
    "push": (
        "telenano_assembly.push_command:push",
        "Push one particle, in simulated time or on a rig.",
    ),
    "assemble": (
        "telenano_assembly.assemble_command:assemble",
        "Push particles into a pattern, in simulated time.",
    ),
}

"""The commands of this package; each is imported when it runs."""

_DEVICE = "telenano_afm_controllers.device"
COMMANDS = {
    "device simulate gwyscope": (
        f"{_DEVICE}:simulate_gwyscope",
        "Serve an emulated Gwyscope with stage and cantilever behind it. Ctrl-C ends it, with z at 0.",
    ),
    "device simulate nanonis": (
        f"{_DEVICE}:simulate_nanonis",
        "Serve an emulated Nanonis controller with stage and cantilever behind it. Ctrl-C ends it.",
    ),
    "device guard gwyscope": (
        f"{_DEVICE}:guard_gwyscope",
        "Stand between rig and Gwyscope, and retract the tip when the rig is silent. Ctrl-C ends it, retracted.",
    ),
    "device guard nanonis": (
        f"{_DEVICE}:guard_nanonis",
        "Stand between rig and Nanonis, and withdraw the tip when the rig is silent. Ctrl-C ends it, withdrawn.",
    ),
    "device approach": (
        f"{_DEVICE}:approach_nanonis",
        "Let a Nanonis controller approach, switch its z-controller off and lift the tip: for its external input.",
    ),
}

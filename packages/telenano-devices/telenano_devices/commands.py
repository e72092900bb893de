"""The commands of this distribution, which telenano lists without importing their modules."""

COMMANDS = {
    "device simulate handle": (
        "telenano_devices.handle.simulate_handle:simulate_handle",
        "Run an emulated handle: the firmware, the motor and the hand, on a port of its own. Ctrl-C ends it.",
    ),
    "device simulate t7": (
        "telenano_devices.t7.simulate_t7:simulate_t7",
        "Serve the model of a LabJack T7 with stage and cantilever behind it, over Modbus TCP. Ctrl-C ends it.",
    ),
    "device simulate haply": (
        "telenano_devices.haply.simulate_haply:simulate_haply",
        "Run an emulated Inverse Service with an Inverse3, a VerseGrip and a hand on it.",
    ),
    "device simulate gwyscope": (
        "telenano_devices.gwyscope.gwyscope_commands:simulate_gwyscope",
        "Serve an emulated Gwyscope with stage and cantilever behind it. Ctrl-C ends it, with z at 0.",
    ),
    "device simulate nanonis": (
        "telenano_devices.nanonis.nanonis_commands:simulate_nanonis",
        "Serve an emulated Nanonis controller with stage and cantilever behind it. Ctrl-C ends it.",
    ),
    "device guard gwyscope": (
        "telenano_devices.gwyscope.gwyscope_commands:guard_gwyscope",
        "Stand between rig and Gwyscope, and retract the tip when the rig is silent. Ctrl-C ends it, retracted.",
    ),
    "device guard nanonis": (
        "telenano_devices.nanonis.nanonis_commands:guard_nanonis",
        "Stand between rig and Nanonis, and withdraw the tip when the rig is silent. Ctrl-C ends it, withdrawn.",
    ),
    "device approach": (
        "telenano_devices.nanonis.nanonis_commands:approach_nanonis",
        "Let a Nanonis controller approach, switch its z-controller off and lift the tip: for its external input.",
    ),
    "device accept": (
        "telenano_devices.acceptance.accept_command:accept",
        "Lead through a motion of one minute, and report each check: pass, fail, retake or cannot say.",
    ),
    "device monitor": (
        "telenano_devices.acceptance.look_commands:monitor",
        "Read a device without driving it, and report the age of its samples, losses and bad frames.",
    ),
    "device probe": (
        "telenano_devices.acceptance.look_commands:probe",
        "Identify a handle, an instrument or a driver's device.",
    ),
    "device trial": (
        "telenano_devices.acceptance.trial.trial_command:trial",
        "Try your device with a question before each step, and write one file; or make its page.",
    ),
    "device calibrate": (
        "telenano_devices.calibrate_device_command:app",
        "Measure a device, and write its calibration file.",
    ),
}

"""The packages that this project keeps beside its core: the one table that suggests them where they are missing."""

# A command, a format of `bag export`, a reader, or a name in a scenario or an experiment, and its distribution.
KNOWN_PACKAGES = {
    "command assemble": "telenano-assembly",
    "command bag diff": "telenano-studies",
    "command bag fetch": "telenano-wide-area",
    "command bag plot": "telenano-studies",
    "command bag recalibrate": "telenano-calibration",
    "command benchmark": "telenano-experiments",
    "command bridge foxglove": "telenano-foxglove",
    "command bridge lsl": "telenano-lsl",
    "command bridge ros2": "telenano-ros2",
    "command budget": "telenano-calibration",
    "command calibrate": "telenano-calibration",
    "command compare": "telenano-studies",
    "command conformance": "telenano-conformance",
    "command curve": "telenano-microscopy",
    "command device accept": "telenano-acceptance",
    "command device approach": "telenano-afm-controllers",
    "command device calibrate": "telenano-calibration",
    "command device guard gwyscope": "telenano-afm-controllers",
    "command device guard nanonis": "telenano-afm-controllers",
    "command device monitor": "telenano-acceptance",
    "command device probe": "telenano-acceptance",
    "command device simulate gwyscope": "telenano-afm-controllers",
    "command device simulate handle": "telenano-emulators",
    "command device simulate haply": "telenano-haptic-devices",
    "command device simulate nanonis": "telenano-afm-controllers",
    "command device simulate t7": "telenano-emulators",
    "command device trial": "telenano-acceptance",
    "command experiment": "telenano-experiments",
    "command inspect": "telenano-afm-files",
    "command law balance": "telenano-conformance",
    "command law by-line": "telenano-laws",
    "command link fit": "telenano-networks",
    "command link picture": "telenano-networks",
    "command link probe": "telenano-networks",
    "command link report": "telenano-networks",
    "command link udp": "telenano-networks",
    "command particles": "telenano-assembly",
    "command push": "telenano-assembly",
    "command relay": "telenano-wide-area",
    "command reproduce": "telenano-studies",
    "command sample": "telenano-microscopy",
    "command sample import": "telenano-afm-files",
    "command sample info": "telenano-afm-files",
    "command scan": "telenano-microscopy",
    "command study": "telenano-studies",
    "command topic pub": "telenano-networks",
    "driver dhd": "telenano-haptic-devices",
    "driver gwyscope": "telenano-afm-controllers",
    "driver haply": "telenano-haptic-devices",
    "driver hd": "telenano-haptic-devices",
    "driver nanonis": "telenano-afm-controllers",
    "driver simulated_impedance": "telenano-haptic-devices",
    "format csv": "telenano-tables",
    "format hdf5": "telenano-tables",
    "format nexus": "telenano-nexus",
    "format parquet": "telenano-tables",
    "format protobuf": "telenano-protobuf",
    "format ros2": "telenano-ros2",
    "law bounded_model": "telenano-laws",
    "law four_channel": "telenano-laws",
    "law fractal_impedance": "telenano-laws",
    "law matched_wave": "telenano-laws",
    "law model_mediated": "telenano-laws",
    "law smith": "telenano-laws",
    "law tdpa": "telenano-laws",
    "law two_layer": "telenano-laws",
    "layer particles": "telenano-assembly",
    "map npz": "telenano-afm-files",
    "program push": "telenano-assembly",
    "reader other": "telenano-afm-files",
    "scenario assembly": "telenano-assembly",
    "section coupling": "telenano-haptic-devices",
    "section impedance": "telenano-haptic-devices",
    "task detect_contact": "telenano-experiments",
    "task discriminate_stiffness": "telenano-experiments",
    "task follow_profile": "telenano-experiments",
    "task push_particle": "telenano-experiments",
    "task touch_and_hold": "telenano-experiments",
    "task track": "telenano-experiments",
    "topic afm/particles": "telenano-assembly",
    "topic experiment/answer": "telenano-experiments",
    "topic experiment/cue": "telenano-experiments",
    "topic experiment/trial": "telenano-experiments",
    "transport datagram": "telenano-wide-area",
}
# Drivers of these packages that are simulated, for recordings where the package is not installed.
SIMULATED_DRIVERS = ("simulated_impedance",)
# what `link.transport: auto` of a site file takes where it is installed
KNOWN_TRANSPORT = "datagram"
# the laws of this table that close no loop through the instrument, of which a slow one needs one
KNOWN_MODEL_LAWS = ("model_mediated", "bounded_model")


def known_of(kind: str) -> dict[str, str]:
    """Return the packages of a kind of things, such as `driver` or `law`, by the names of the things."""
    rows = ((words.partition(" "), package) for words, package in KNOWN_PACKAGES.items())
    return {name: package for (first, _, name), package in rows if first == kind}


def where_it_is(words: str) -> str:
    """Return which package of this project has a thing and how it is installed; empty where none has.

    Args:
        words: The kind of the thing and its name as in `KNOWN_PACKAGES`, such as `command scan`, `driver nanonis` or
            `law smith`.
    """
    from telenano.wire.extras import how_to_add_package

    package = KNOWN_PACKAGES.get(words, "")
    return f"the {words} is in the package {package}: {how_to_add_package(package)}" if package else ""

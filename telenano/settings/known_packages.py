"""The packages that this project keeps beside its core: the one table that suggests them where they are missing."""

# A command, a format of `bag export`, a reader, or a name in a scenario or an experiment, and its distribution.
KNOWN_PACKAGES = {
    "assemble": "telenano-assembly",
    "bag diff": "telenano-studies",
    "bag fetch": "telenano-wide-area",
    "bag plot": "telenano-studies",
    "bag recalibrate": "telenano-calibration",
    "benchmark": "telenano-experiments",
    "bridge foxglove": "telenano-foxglove",
    "bridge lsl": "telenano-lsl",
    "bridge ros2": "telenano-ros2",
    "budget": "telenano-calibration",
    "calibrate": "telenano-calibration",
    "compare": "telenano-studies",
    "conformance": "telenano-conformance",
    "curve": "telenano-microscopy",
    "device accept": "telenano-acceptance",
    "device approach": "telenano-afm-controllers",
    "device calibrate": "telenano-calibration",
    "device guard gwyscope": "telenano-afm-controllers",
    "device guard nanonis": "telenano-afm-controllers",
    "device monitor": "telenano-acceptance",
    "device probe": "telenano-acceptance",
    "device simulate gwyscope": "telenano-afm-controllers",
    "device simulate handle": "telenano-emulators",
    "device simulate haply": "telenano-haptic-devices",
    "device simulate nanonis": "telenano-afm-controllers",
    "device simulate t7": "telenano-emulators",
    "driver dhd": "telenano-haptic-devices",
    "driver gwyscope": "telenano-afm-controllers",
    "driver haply": "telenano-haptic-devices",
    "driver hd": "telenano-haptic-devices",
    "driver modbus": "telenano-afm-controllers",
    "driver nanonis": "telenano-afm-controllers",
    "driver serial": "telenano-haptic-devices",
    "experiment": "telenano-experiments",
    "format csv": "telenano-tables",
    "format hdf5": "telenano-tables",
    "format nexus": "telenano-nexus",
    "format parquet": "telenano-tables",
    "format protobuf": "telenano-protobuf",
    "format ros2": "telenano-ros2",
    "inspect": "telenano-afm-files",
    "law bounded_model": "telenano-laws",
    "law four_channel": "telenano-laws",
    "law fractal_impedance": "telenano-laws",
    "law matched_wave": "telenano-laws",
    "law smith": "telenano-laws",
    "law tdpa": "telenano-laws",
    "law two_layer": "telenano-laws",
    "layer particles": "telenano-assembly",
    "link fit": "telenano-networks",
    "link probe": "telenano-networks",
    "map npz": "telenano-afm-files",
    "particles": "telenano-assembly",
    "program push": "telenano-assembly",
    "push": "telenano-assembly",
    "reader other": "telenano-afm-files",
    "relay": "telenano-wide-area",
    "reproduce": "telenano-studies",
    "sample": "telenano-microscopy",
    "sample import": "telenano-afm-files",
    "sample info": "telenano-afm-files",
    "scenario assembly": "telenano-assembly",
    "scan": "telenano-microscopy",
    "study": "telenano-studies",
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
    "topic pub": "telenano-networks",
    "transport datagram": "telenano-wide-area",
}
# what `link.transport: auto` of a site file takes where it is installed
KNOWN_TRANSPORT = "datagram"


def where_it_is(words: str) -> str:
    """Return which package of this project has a thing and how it is installed; empty where none has.

    Args:
        words: The kind of the thing and its name as in `KNOWN_PACKAGES`, such as `driver nanonis` or `law smith`.
    """
    from telenano.wire.extras import how_to_add_package

    package = KNOWN_PACKAGES.get(words, "")
    return f"the {words} is in the package {package}: {how_to_add_package(package)}" if package else ""

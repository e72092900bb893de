"""Packages of this project beside its core: the one table by which messages suggest a package that is missing."""

from telenano.wire.extras import OWN_PACKAGES as OWN_PACKAGES

# A command, a format of `bag export`, a reader, or a name in a scenario or an experiment, and its distribution with the
# extra that it needs.
KNOWN_PACKAGES = {
    "adviser benchmark": "telenano-lab",
    "command assemble": "telenano-lab",
    "command bag diff": "telenano-lab",
    "command bag fetch": "telenano-wide-area",
    "command bag plot": "telenano-lab",
    "command bag recalibrate": "telenano-lab",
    "command benchmark": "telenano-lab[experiments]",
    "command bridge foxglove": "telenano-bridges[foxglove]",
    "command bridge lsl": "telenano-bridges[lsl]",
    "command bridge ros2": "telenano-bridges[ros2]",
    "command budget": "telenano-lab",
    "command calibrate": "telenano-lab",
    "command compare": "telenano-lab",
    "command curve": "telenano-lab",
    "command curve fit": "telenano-lab[files]",
    "command device accept": "telenano-devices",
    "command device approach": "telenano-devices",
    "command device calibrate": "telenano-devices",
    "command device guard gwyscope": "telenano-devices",
    "command device guard nanonis": "telenano-devices",
    "command device monitor": "telenano-devices",
    "command device probe": "telenano-devices",
    "command device simulate gwyscope": "telenano-devices",
    "command device simulate handle": "telenano-devices",
    "command device simulate haply": "telenano-devices",
    "command device simulate nanonis": "telenano-devices",
    "command device simulate t7": "telenano-devices",
    "command device trial": "telenano-devices",
    "command experiment": "telenano-lab[experiments]",
    "command inspect": "telenano-lab[files]",
    "command law by-line": "telenano-laws",
    "command link fit": "telenano-lab",
    "command link picture": "telenano-lab",
    "command link probe": "telenano-lab",
    "command link report": "telenano-lab",
    "command link udp": "telenano-lab",
    "command particles": "telenano-lab",
    "command push": "telenano-lab",
    "command gateway": "telenano-wide-area[gateway]",
    "command relay": "telenano-wide-area",
    "command reproduce": "telenano-lab",
    "command sample": "telenano-lab",
    "command sample import": "telenano-lab[files]",
    "command sample info": "telenano-lab[files]",
    "command scan": "telenano-lab",
    "command study": "telenano-lab",
    "command study drift": "telenano-lab[experiments]",
    "command topic pub": "telenano-lab",
    "driver dhd": "telenano-devices",
    "driver gwyscope": "telenano-devices",
    "driver haply": "telenano-devices",
    "driver hd": "telenano-devices",
    "driver nanonis": "telenano-devices",
    "driver simulated_impedance": "telenano-devices",
    "format csv": "telenano-bridges[tables]",
    "format hdf5": "telenano-bridges[tables]",
    "format nexus": "telenano-bridges[nexus]",
    "format parquet": "telenano-bridges[tables]",
    "format protobuf": "telenano-bridges[protobuf]",
    "format ros2": "telenano-bridges[ros2]",
    "law bounded_model": "telenano-laws",
    "law four_channel": "telenano-laws",
    "law fractal_impedance": "telenano-laws",
    "law matched_wave": "telenano-laws",
    "law model_mediated": "telenano-laws",
    "law smith": "telenano-laws",
    "law tdpa": "telenano-laws",
    "law two_layer": "telenano-laws",
    "layer particles": "telenano-lab",
    "map npz": "telenano-lab",
    "program push": "telenano-lab",
    "reader other": "telenano-lab[files]",
    "scenario assembly": "telenano-lab",
    "section coupling": "telenano-devices",
    "section impedance": "telenano-devices",
    "task detect_contact": "telenano-lab[experiments]",
    "task discriminate_stiffness": "telenano-lab[experiments]",
    "task follow_profile": "telenano-lab[experiments]",
    "task push_particle": "telenano-lab[experiments]",
    "task touch_and_hold": "telenano-lab[experiments]",
    "task track": "telenano-lab[experiments]",
    "topic afm/particles": "telenano-lab",
    "topic experiment/answer": "telenano-lab",
    "topic experiment/cue": "telenano-lab",
    "topic experiment/trial": "telenano-lab",
    "transport datagram": "telenano-wide-area",
}
# Drivers of these packages that are simulated, for recordings where the package is not installed.
SIMULATED_DRIVERS = ("simulated_impedance",)
# The transport that `link.transport: auto` of a site file selects where it is installed.
KNOWN_TRANSPORT = "datagram"
# Laws of this table that close no loop through the instrument; a slow instrument needs one of them.
KNOWN_MODEL_LAWS = ("model_mediated", "bounded_model")


def known_of(kind: str) -> dict[str, str]:
    """Return the packages of the entries of a kind, such as `driver` or `law`, by the names of the entries."""
    rows = ((words.partition(" "), package) for words, package in KNOWN_PACKAGES.items())
    return {name: package for (first, _, name), package in rows if first == kind}


def where_it_is(words: str) -> str:
    """Return a sentence with the package of this project that has an entry and how to install it; empty where none has.

    Args:
        words: The kind of the entry and its name as in `KNOWN_PACKAGES`, such as `command scan`, `driver nanonis` or
            `law smith`.
    """
    from telenano.wire.extras import how_to_add_package

    package = KNOWN_PACKAGES.get(words, "")
    return f"the {words} is in the package {package}: {how_to_add_package(package)}" if package else ""

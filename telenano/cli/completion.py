"""What the shell completes besides commands and options. Nothing is imported here that takes time."""


def scenario_names(incomplete: str) -> list[str]:
    """Return the known scenarios that begin so."""
    from presets import known_scenarios

    return [name for name in known_scenarios() if name.startswith(incomplete)]


def scenario_sections(incomplete: str) -> list[str]:
    """Return the sections of a scenario that begin so."""
    from proto.nodes import SERVICES

    return [name for name in SERVICES if name.startswith(incomplete)]


def topic_names(incomplete: str) -> list[str]:
    """Return the topics that begin so, and their copies that left the link."""
    from proto import TOPICS

    names = list(TOPICS)
    copies = {"forward": ("slave",), "backward": ("master",), "both": ("slave", "master"), None: ()}
    names += [f"{name}@{site}" for name, row in TOPICS.items() for site in copies[row.bridged]]
    return [name for name in names if name.startswith(incomplete)]


def law_names(incomplete: str) -> list[str]:
    """Return the laws that begin so, those of installed packages included, and `all`; of a list a,b,c the last part."""
    before, comma, last = incomplete.rpartition(",")
    known = [*law_name(last), *(["all"] if "all".startswith(last) else [])]
    return [f"{before}{comma}{name}" for name in known]


def law_name(incomplete: str) -> list[str]:
    """Return the laws that begin so, those of installed packages included, without importing one."""
    from presets.plugins import installed
    from services.controller.law_names import LAW_NAMES

    return [name for name in (*LAW_NAMES, *installed("laws")) if name.startswith(incomplete)]


def service_names(incomplete: str) -> list[str]:
    """Return what `telenano node` takes that begins so: names without a site, and `list`."""
    from proto.nodes import SERVICES

    return [name for name in (*SERVICES, "list") if name.startswith(incomplete)]


def node_names(incomplete: str) -> list[str]:
    """Return the nodes of a rig that begin so, by name and as name@site."""
    from proto.nodes import START_ORDER, name_of

    return [name for name in (*dict.fromkeys(map(name_of, START_ORDER)), *START_ORDER) if name.startswith(incomplete)]

"""What `telenano doctor` checks for this package."""

from telenano.doctor import Finding
from telenano.wire import ConfigError


def check_library() -> list[Finding]:
    """Say whether pylsl finds liblsl on this machine."""
    from telenano_lsl.bridge import lsl_streams

    try:
        lsl_streams()
    except ConfigError as error:
        return [Finding("LSL", "warning", str(error), "only `telenano bridge lsl` needs it")]
    return [Finding("LSL", "ok", "pylsl finds liblsl")]

"""What a recording of a session holds: columns of its messages on the clock of the session, and its settings."""

from analysis.report import scenario_in
from proto.errors import ConfigError, RecordingError
from proto.messages import AfmScanline
from recording.arrays import columns, last_programme
from recording.site_clock import Timeline
from services.afm_node.config import AfmConfig
from services.runtime.settings.config import validate

__all__ = [
    "AfmConfig",
    "AfmScanline",
    "ConfigError",
    "RecordingError",
    "Timeline",
    "columns",
    "last_programme",
    "scenario_in",
    "validate",
]

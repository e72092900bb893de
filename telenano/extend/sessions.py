"""What a recording of a session holds: columns of its messages on the clock of the session, and its settings."""

from services.afm_node.config import AfmConfig as AfmConfig
from services.console.command_client import send_control as send_control
from services.controller.config import ControllerConfig as ControllerConfig
from services.delay_node.profiles import profile_named as profile_named
from services.runtime.loop.commands import Command as Command
from services.runtime.settings.config import validate as validate
from services.viz_node.fig12 import SessionSeries as SessionSeries
from telenano.analysis.conditions import described as described
from telenano.analysis.mean_interval import mean_half_width as mean_half_width
from telenano.analysis.report import scenario_in as scenario_in
from telenano.recording.arrays import columns as columns
from telenano.recording.arrays import last_programme as last_programme
from telenano.recording.multi_file import open_recordings as open_recordings
from telenano.recording.site_clock import Timeline as Timeline
from telenano.wire.errors import ConfigError as ConfigError
from telenano.wire.errors import RecordingError as RecordingError
from telenano.wire.messages import AfmScanline as AfmScanline

"""What a recording of a session holds: columns of its messages on the clock of the session, and its settings."""

from telenano.afm.config import AfmConfig as AfmConfig
from telenano.analysis.conditions import described as described
from telenano.analysis.fig12 import SessionSeries as SessionSeries
from telenano.analysis.mean_interval import mean_half_width as mean_half_width
from telenano.analysis.report import scenario_in as scenario_in
from telenano.console.command_client import send_control as send_control
from telenano.laws.config import ControllerConfig as ControllerConfig
from telenano.link.profiles import profile_named as profile_named
from telenano.recording.arrays import columns as columns
from telenano.recording.arrays import last_programme as last_programme
from telenano.recording.multi_file import open_recordings as open_recordings
from telenano.recording.site_clock import Timeline as Timeline
from telenano.runtime.loop.commands import Command as Command
from telenano.settings.config import validate as validate
from telenano.wire.errors import ConfigError as ConfigError
from telenano.wire.errors import RecordingError as RecordingError
from telenano.wire.messages import AfmScanline as AfmScanline

"""A command of one's own: errors as sentences and exit codes, results as JSON, and the options that others share."""

from telenano.cli.commands.device_files import run_ahead as run_ahead
from telenano.cli.commands.device_files import section_of as section_of
from telenano.cli.commands.device_files import write_document as write_document
from telenano.cli.options import DurationOption as DurationOption
from telenano.cli.options import JsonOption as JsonOption
from telenano.cli.options import SiteFileOption as SiteFileOption
from telenano.cli.options import command_group as command_group
from telenano.cli.output import print_document as print_document
from telenano.cli.output import print_json as print_json
from telenano.cli.output import report_errors as report_errors
from telenano.cli.progress import progress as progress
from telenano.settings import DEFAULT_SITE_FILE as DEFAULT_SITE_FILE
from telenano.settings.config import flag_overrides as flag_overrides
from telenano.wire.errors import ConfigError as ConfigError
from telenano.wire.errors import TelenanoError as TelenanoError

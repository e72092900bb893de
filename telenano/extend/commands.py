"""A command of one's own: errors as sentences and exit codes, results as JSON, and the options that others share."""

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError, TelenanoError
from services.runtime.settings.config import flag_overrides
from telenano.cli.commands.device_files import run_ahead, section_of, write_document
from telenano.cli.options import DurationOption, JsonOption, SiteFileOption, command_group
from telenano.cli.output import print_document, print_json, report_errors
from telenano.cli.progress import progress

__all__ = [
    "DEFAULT_SITE_FILE",
    "ConfigError",
    "DurationOption",
    "JsonOption",
    "SiteFileOption",
    "TelenanoError",
    "command_group",
    "flag_overrides",
    "print_document",
    "print_json",
    "progress",
    "report_errors",
    "run_ahead",
    "section_of",
    "write_document",
]

"""The command line: parsing, printing, completion, exit codes."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.cli.child_session import run_session as run_session
    from telenano.cli.commands.device_files import run_ahead as run_ahead
    from telenano.cli.commands.device_files import section_of as section_of
    from telenano.cli.commands.topic import open_observer as open_observer
    from telenano.cli.completion import law_names as law_names
    from telenano.cli.exit_codes import EXIT_FAILED as EXIT_FAILED
    from telenano.cli.keyboard import RawKeyboard as RawKeyboard
    from telenano.cli.model_options import validated as validated
    from telenano.cli.model_options import with_options as with_options
    from telenano.cli.option_rules import Keys as Keys
    from telenano.cli.option_rules import Void as Void
    from telenano.cli.option_rules import rules as rules
    from telenano.cli.options import DurationOption as DurationOption
    from telenano.cli.options import EndOption as EndOption
    from telenano.cli.options import ExcludeOption as ExcludeOption
    from telenano.cli.options import FormatOption as FormatOption
    from telenano.cli.options import JobsOption as JobsOption
    from telenano.cli.options import JsonOption as JsonOption
    from telenano.cli.options import RigFileOption as RigFileOption
    from telenano.cli.options import SameSessionOption as SameSessionOption
    from telenano.cli.options import SiteFileOption as SiteFileOption
    from telenano.cli.options import StartOption as StartOption
    from telenano.cli.options import StyleOption as StyleOption
    from telenano.cli.options import TableOption as TableOption
    from telenano.cli.options import TopicsOption as TopicsOption
    from telenano.cli.options import command_group as command_group
    from telenano.cli.options import table_formats as table_formats
    from telenano.cli.output import console as console
    from telenano.cli.output import fail_incomplete as fail_incomplete
    from telenano.cli.output import print_answer as print_answer
    from telenano.cli.output import print_document as print_document
    from telenano.cli.output import print_json as print_json
    from telenano.cli.output import print_rows as print_rows
    from telenano.cli.output import report_errors as report_errors
    from telenano.cli.output import results_in as results_in
    from telenano.cli.output import say as say
    from telenano.cli.progress_bar import progress as progress
else:
    __getattr__, __dir__ = face(__name__)

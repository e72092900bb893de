"""A kit for the tests of packages: nodes, rigs, recordings, wires and damaged files, as a plug-in of pytest.

`pip install telenano[testing]` adds pytest, which finds the fixtures of `telenano.testing.plugin` by itself. The
functions and classes exported here work with any other test runner too. README.md of this folder has tests with them.
"""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.testing.bench import HandRig as HandRig
    from telenano.testing.bench import InstrumentRig as InstrumentRig
    from telenano.testing.bench import NodeBench as NodeBench
    from telenano.testing.bench import VirtualClock as VirtualClock
    from telenano.testing.bench import afm_config as afm_config
    from telenano.testing.bench import afm_node as afm_node
    from telenano.testing.bench import handed_over as handed_over
    from telenano.testing.bench import haptic_config as haptic_config
    from telenano.testing.bench import haptic_device_of as haptic_device_of
    from telenano.testing.bench import haptic_node as haptic_node
    from telenano.testing.bench import instrument_of as instrument_of
    from telenano.testing.bench import refused_laws as refused_laws
    from telenano.testing.bench import refused_program as refused_program
    from telenano.testing.bench import trial as trial
    from telenano.testing.commands import invoke as invoke
    from telenano.testing.commands import options_of as options_of
    from telenano.testing.commands import run as run
    from telenano.testing.commands import run_apart as run_apart
    from telenano.testing.commands import run_program as run_program
    from telenano.testing.damage import damaged as damaged
    from telenano.testing.filled_messages import examples as examples
    from telenano.testing.frames import Frames as Frames
    from telenano.testing.hostile import HOSTILITIES as HOSTILITIES
    from telenano.testing.hostile import HostileService as HostileService
    from telenano.testing.hostile import TakenReading as TakenReading
    from telenano.testing.hostile import unseen as unseen
    from telenano.testing.law_balance.balance import Balance as Balance
    from telenano.testing.law_balance.balance import balance as balance
    from telenano.testing.law_balance.balance import states_passivity as states_passivity
    from telenano.testing.law_balance.balance import worst_balances as worst_balances
    from telenano.testing.law_balance.balance_draws import ADVERSE as ADVERSE
    from telenano.testing.law_balance.balance_draws import EVERYTHING as EVERYTHING
    from telenano.testing.law_balance.balance_draws import drawn as drawn
    from telenano.testing.law_loop import LOST as LOST
    from telenano.testing.law_loop import LawRun as LawRun
    from telenano.testing.law_loop import run_law as run_law
    from telenano.testing.leases import LeaseOfRig as LeaseOfRig
    from telenano.testing.made_tables import print_table as print_table
    from telenano.testing.messages import EPOCH_NS as EPOCH_NS
    from telenano.testing.messages import fields_of as fields_of
    from telenano.testing.messages import hand_state as hand_state
    from telenano.testing.messages import numbered as numbered
    from telenano.testing.messages import payload as payload
    from telenano.testing.messages import received as received
    from telenano.testing.packages import describe_package as describe_package
    from telenano.testing.packages import environment_with as environment_with
    from telenano.testing.packages import install_package as install_package
    from telenano.testing.packages import run_with as run_with
    from telenano.testing.packages import said_with as said_with
    from telenano.testing.processes import LiveRig as LiveRig
    from telenano.testing.recordings import HEIGHTS_M as HEIGHTS_M
    from telenano.testing.recordings import foreign_recording as foreign_recording
    from telenano.testing.recordings import hand_recording as hand_recording
    from telenano.testing.recordings import record_fig12 as record_fig12
    from telenano.testing.recordings import recording_with as recording_with
    from telenano.testing.recordings import rich_recording as rich_recording
    from telenano.testing.recordings import write_recording as write_recording
    from telenano.testing.shared_files import Shared as Shared
    from telenano.testing.shared_files import SharedFiles as SharedFiles
    from telenano.testing.shared_files import disk_of as disk_of
    from telenano.testing.shared_files import fill_at_each_write as fill_at_each_write
    from telenano.testing.shared_files import race as race
    from telenano.testing.shared_files import small_disk as small_disk
    from telenano.testing.sites import SiteLauncher as SiteLauncher
    from telenano.testing.vectors import assert_same_bytes as assert_same_bytes
    from telenano.testing.vectors import assert_same_schema as assert_same_schema
    from telenano.testing.vectors import case_of as case_of
    from telenano.testing.vectors import vectors_of as vectors_of
    from telenano.testing.waiting import PATIENCE_S as PATIENCE_S
    from telenano.testing.waiting import free_ports as free_ports
    from telenano.testing.waiting import until as until
    from telenano.testing.wires import RequestLine as RequestLine
    from telenano.testing.wires import handle_wire as handle_wire
    from telenano.testing.wires import shorten_waits as shorten_waits
else:
    __getattr__, __dir__ = face(__name__)

"""`telenano doctor`: check this machine before, or while, a rig runs, and advise what to change.

What may be missing on it is imported late: its absence is a finding.
"""

import importlib.util
import resource
import shutil
import sys
import time
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from telenano.cli.lazy_commands import NAMED_RIG
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import JsonOption, SiteFileOption
from telenano.cli.output import console, fail, print_answer, print_json, report_errors
from telenano.doctor import checks
from telenano.doctor.devices import check_instrument, check_serial_ports
from telenano.extend.checks import Finding
from telenano.launcher.processors import held, shared_folder
from telenano.runtime.bus.local_endpoint import FIRST_RIG, rigs_with_folders
from telenano.settings.included import DEFAULT_SITE_FILE
from telenano.settings.package_topics import installed_topics, row_of
from telenano.settings.plugins import (
    KINDS,
    all_installed,
    code_of,
    installed,
    known_problems,
    load,
    of_no_kind,
    scenario_files,
)
from telenano.signals.children import permitted
from telenano.wire.errors import ConfigError, EndpointError, RigError, TelenanoError
from telenano.wire.extras import extra_of, how_to_install

if TYPE_CHECKING:
    from telenano.runtime.bus.address_book import AddressBook

_STYLES = {"ok": "green", "warning": "yellow", "problem": "red"}


@rules(Void("*", "which checks nothing", beside="--warm", but="--json"))
def doctor(
    context: typer.Context,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    stage: Annotated[
        Path | None,
        typer.Option("--stage", metavar="FILE", help="stage.yaml of an instrument whose connection is to be checked."),
    ] = None,
    warm: Annotated[
        bool, typer.Option("--warm", help="Check nothing, and compile the models of every law in Fig. 12 beforehand.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check whether this machine can run a rig, and advise what to change; exit code 1 if there is a problem."""
    with report_errors(as_json):
        if warm:
            compile_models(as_json=as_json)
            return
        named = context.meta.get(NAMED_RIG, FIRST_RIG)
        if named not in rigs_with_folders():
            raise RigError(
                f"there is no rig {named} on this machine, there are {', '.join(rigs_with_folders())}: leave --rig out "
                f"to check the machine for a new one"
            )
        findings = examine(site_file)
        if stage is not None:
            findings.append(check_instrument(stage))
        print_findings(findings, as_json=as_json)


def compile_models(*, as_json: bool) -> None:
    """Simulate two ticks of each law, so that the code of later sessions is compiled in the user's cache."""
    from telenano.lockstep.simulation import compile_scenario
    from telenano.sections.controller_section import KNOWN_LAWS

    if importlib.util.find_spec("numba") is None:
        raise ConfigError(f"numba is not installed, and nothing can be compiled: {how_to_install(extra_of('numba'))}")
    taken_s = {}
    for law in KNOWN_LAWS:
        begun_s = time.monotonic()
        compile_scenario("fig12", law)
        taken_s[law] = round(time.monotonic() - begun_s, 2)
        if not as_json:
            typer.echo(f"{law}: compiled, or found compiled, in {taken_s[law]:.1f} s")
    if as_json:
        print_json({"warmed_s": taken_s})


def examine(site_file: Path) -> list[Finding]:
    """Run every check that this machine allows."""
    findings = [checks.check_python(sys.version_info[:3]), *packages()]
    # The checks of packages run first, so that `extensions` knows of packages that cannot be loaded.
    findings += [*checks_of_packages(), *extensions(), checks.check_advisers(installed("advisers"))]
    findings += machine(container=checks.in_container())
    try:
        return [*findings, *rig(site_file)]
    except ImportError as error:
        # The packages that every process needs are missing, so no site file can be read.
        return [*findings, Finding("site file", "problem", str(error), "install the missing packages first, see above")]


def machine(*, container: bool) -> list[Finding]:
    """Check what this machine permits a process of this user to do."""
    usable = permitted()
    quota = checks.cpu_quota(Path("/sys/fs/cgroup"), Path("/proc/self/cgroup"))
    runtime = Path("/proc/sys/kernel/sched_rt_runtime_us")
    runtime_us = runtime.read_text().strip() if runtime.exists() else None
    here = Path.cwd()
    return [
        checks.check_processors(len(usable), quota),
        checks.check_rig_processors(len(usable), held(usable, shared_folder())),
        checks.check_fifo(checks.attempt_fifo(), _limit(resource.RLIMIT_RTPRIO), runtime_us, container=container),
        checks.check_memory_lock(checks.attempt_memory_lock(), _limit(resource.RLIMIT_MEMLOCK), container=container),
        checks.check_synchronised(checks.kernel_clock()),
        checks.check_disk(here, shutil.disk_usage(here).free),
        *check_serial_ports(),
    ]


def print_findings(findings: Sequence[Finding], *, as_json: bool) -> None:
    """Print the findings and exit with 1 if one of them is a problem."""
    problems = [finding.name for finding in findings if finding.level == "problem"]
    warnings = [finding.name for finding in findings if finding.level == "warning"]
    document: dict[str, Any] = {"ok": not problems, "findings": [finding._asdict() for finding in findings]}
    if not as_json:
        console().print(findings_table(findings))
    if problems:
        fail(f"a rig cannot run here as it is: {', '.join(problems)}", as_json=as_json, **document)
    text = f"a rig can run here, {len(warnings)} warning(s){': ' if warnings else ''}{', '.join(warnings)}"
    print_answer(document, text, as_json=as_json)


def findings_table(findings: Sequence[Finding]) -> Table:
    """Draw findings, each with its advice below."""
    table = Table("check", "level", "found")
    for finding in findings:
        text = Text(finding.found)
        if finding.advice:
            text.append(f"\n→ {finding.advice}", "bold")
        table.add_row(finding.name, Text(finding.level, _STYLES[finding.level]), text)
    return table


def packages() -> list[Finding]:
    """Compare the installed packages with those that the project requires."""
    try:
        return checks.check_packages(requires("telenano") or (), _installed)
    except PackageNotFoundError:
        advice = "run `pip install -e .` in its folder"
        return [Finding("packages", "problem", "telenano is run without being installed", advice)]


def extensions() -> list[Finding]:
    """Load the extensions of installed packages, if there are any, and report those that cannot be used."""
    rows, strays = all_installed(), of_no_kind()
    if not rows and not strays:
        return []
    from telenano.runtime.wiring.main import node_kind
    from telenano.sections.afm_section import DRIVERS as INSTRUMENTS
    from telenano.sections.hand_section import DRIVERS as HANDLES
    from telenano.wire.nodes import SERVICES

    for name in SERVICES:
        node_kind(name)
    for drivers in (INSTRUMENTS, HANDLES):
        drivers.all()
    for kind in KINDS:
        load(kind, lambda _, value: value)
    for topic in installed_topics():
        row_of(topic)
    scenario_files()
    name, texts = "laws and devices", [*known_problems(), *strays]
    if not texts:
        return [Finding(name, "ok", f"{len(rows)} of installed packages can be used")]
    advice = "nothing that does not name them is affected; update or uninstall their packages"
    return [Finding(name, "warning", "; ".join(texts), advice)]


def checks_of_packages() -> list[Finding]:
    """Run the checks of installed packages; a check that fails is itself a finding and does not stop the others."""
    findings: list[Finding] = []
    for name, check in load("checks").found.items():
        package = installed("checks")[name].package
        try:
            with code_of(package):
                findings += [_checked(*finding) for finding in check()]
        except TelenanoError as error:
            findings.append(Finding(name, "warning", str(error)))
    return findings


def _checked(name: str, status: str, found: str, advice: str = "") -> Finding:
    """Return a finding of a package; ValueError for an unknown status."""
    if status not in _STYLES:
        raise ValueError(f"a finding is {', '.join(_STYLES)}, and not {status!r}")
    return Finding(str(name), status, str(found), str(advice))  # type: ignore[arg-type]


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def rig(site_file: Path) -> list[Finding]:
    """Check the rig of a site file; ImportError if a package that every process needs is missing."""
    from telenano.runtime.bus.address_book import AddressBook

    try:
        return _addresses(AddressBook.load(site_file))
    except (ConfigError, EndpointError) as error:
        return [Finding("site file", "problem", str(error), "correct it, or name another with --site-file")]


def _addresses(book: "AddressBook") -> list[Finding]:
    from telenano.runtime.security.keyring import Keyring, this_machine

    keyring = Keyring()
    machine = this_machine(keyring)
    findings = checks.check_endpoints(endpoints_of(book, machine), checks.probe_endpoint)
    if book.requires_keys:
        others = {book.machine_of(node) for node in book.nodes} - {machine}
        findings += checks.check_keys(machine, others, keyring)
    elif book.spans_machines:
        advice = "remove `insecure: true` from it, and make keys with `telenano keys new`"
        findings.append(
            Finding(
                "keys", "warning", "the site file waives them: anyone who can connect to a port can read it", advice
            )
        )
    return findings


def endpoints_of(book: "AddressBook", machine: str) -> dict[str, str]:
    """Return the endpoints that the nodes of a machine bind, each with its node; EndpointError for an unknown name."""
    endpoints = {}
    for node in book.nodes:
        # Without a network, all nodes are on this machine, whatever it is called.
        if book.machine_of(node) == machine or not book.spans_machines:
            for endpoint in (book.local_endpoint(node), book.bind_endpoint(node)):
                if endpoint is not None:
                    endpoints[endpoint] = node
    return endpoints


def _limit(kind: int) -> int:
    return resource.getrlimit(kind)[0]

"""`telenano law by-line`: change the law of a running rig when its line changes."""

import contextlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import DurationOption, SiteFileOption, report_errors, section_of
from telenano.console import live_rig, send_control
from telenano.runtime import Command
from telenano.sections import AfmConfig, ControllerConfig
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import ConfigError, TelenanoError
from telenano_laws.by_line import CANDIDATES, MASTER, TOPICS, Decision, Policy, facts_of

# Targets of the commands that this process sends.
CONTROLLERS = "controller"
RECORDER = "recorder"
# Messages read later than this after they were sent are ignored, because this process cannot keep up [ns].
_LATE_NS = 500_000_000
_WANTED = ",".join(candidate.law for candidate in CANDIDATES)
# Sends a command and returns a node's reason for refusing it, or ""; raises TelenanoError if no node could be asked.
Send = Callable[[Command], str]


def by_line(
    scenario: Annotated[
        Path,
        typer.Option("--scenario", metavar="NAME|FILE", help="Scenario of the rig: parameters of laws, and sample."),
    ],
    laws: Annotated[
        str,
        typer.Option("--law", metavar="LAW[,LAW]", help="Laws to choose among, the most wanted first."),
    ] = _WANTED,
    stiffness: Annotated[
        float | None,
        typer.Option(
            "--stiffness", min=0.0, metavar="N/M", help="Stiffest sample, where the scenario does not state it."
        ),
    ] = None,
    duration: DurationOption = None,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
) -> None:
    """Watch the line of a running rig and change to the first law that tolerates it, until Ctrl-C.

    A law is changed at most once in 10 s, while the hand is nearly at rest, and never to one whose stated limit the
    sample exceeds. Each change is a `set law=...` of the session, and leaves a mark with its reason in the recording.
    """
    made = 0
    with report_errors(False):
        policy = policy_of(scenario, laws, stiffness)
        with live_rig(site_file, TOPICS) as live, contextlib.suppress(KeyboardInterrupt):
            for message in live.messages(duration_s=duration):
                if message.src == MASTER and message.log_ns - message.publish_ns > _LATE_NS:
                    # The hand may have moved on since then.
                    continue
                decision = policy.take(message.topic, message.src, 1e-9 * message.publish_ns, message.decode())
                if decision is not None:
                    made += carry_out(policy, decision, lambda command: _sent(command, site_file))
    typer.echo(f"{made} changes of law", err=True)


def policy_of(scenario: Path, laws: str, stiffness_n_per_m: float | None) -> Policy:
    """Return the policy for the rig of a scenario; raise ConfigError for an unknown law or a missing stiffness."""
    controller = section_of(scenario, "controller", ControllerConfig)
    candidates = {one.law: one for one in CANDIDATES}
    names = laws.split(",")
    if strange := [name for name in names if name not in candidates]:
        raise ConfigError(f"--law: {', '.join(strange)}: law by-line chooses among {', '.join(candidates)}")
    if stiffness_n_per_m is None:
        stiffness_n_per_m = section_of(scenario, "afm_node", AfmConfig).stiffest_n_per_m
    if stiffness_n_per_m is None:
        raise ConfigError(f"{scenario}: does not say how stiff the sample is: give --stiffness")
    return Policy(controller, stiffness_n_per_m, [candidates[name] for name in names])


def carry_out(policy: Policy, decision: Decision, send: Send) -> bool:
    """Change the law, print the result, and mark a change in the recording; return whether the law was changed."""
    text_of_decision = f"law {decision.law}: {decision.reason}"
    try:
        text = send(Command("set", CONTROLLERS, parameters={"law": decision.law}))
    except TelenanoError as error:
        # Another console has control, or no answer came. The law is not at fault, so it is requested again later.
        typer.echo(f"not changed, tried again later: {text_of_decision}: {error}")
        return False
    if text:
        policy.refused(decision.law, text)
        typer.echo(f"refused: {text_of_decision}: {text}")
        return False
    typer.echo(text_of_decision)
    try:
        unmarked = send(Command("mark", RECORDER, parameters=dict(facts_of(decision))))
    except TelenanoError as error:
        unmarked = str(error)
    if unmarked:
        sys.stderr.write(f"telenano: the change is not marked in a recording: {unmarked}\n")
    return True


def _sent(command: Command, site_file: Path) -> str:
    """Send a command to a running rig; return the nodes' reasons for refusing it, empty if none does."""
    answers = send_control(command, site_file, "master", lambda event: None)
    return "; ".join(event.text for event in answers.values() if event.kind == "refused")

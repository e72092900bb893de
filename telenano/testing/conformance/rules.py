"""The rules for clients, each with its section of proto/SPEC.md and the correct behaviour, and the findings."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Outcome = Literal["passed", "failed", "not seen"]
# Number of faults of one rule that are reported; further ones are only counted.
_MOST_LISTED = 3
# Most faults stored for a rule, so that a client cannot fill the memory.
_MOST_KEPT = 1000


class Rule(NamedTuple):
    """A rule: its name, its section of proto/SPEC.md, and the correct behaviour."""

    name: str
    section: str
    right: str


RULES = (
    Rule("connection", "Transport", "bind a PUB socket of ZMTP 3 at the address, and end the handshake within 5 s"),
    Rule("encryption", "Between machines", "a tcp:// endpoint is CURVE, unless the site file has insecure: true"),
    Rule("strangers", "Between machines", "a key that is not in the list is refused in the handshake"),
    Rule("pace", "Topics", "send no faster than it can be read, at the rate that the table has for the topic"),
    Rule("frames", "A message", "send exactly two frames: the topic, then one msgpack map"),
    Rule("topic", "Topics", "send on a topic of the table, by its whole name, in UTF-8"),
    Rule("publisher", "Topics", "src is a node that the table has for the topic, node@site"),
    Rule("size", "A message, Limits", "keep below the most bytes that the table has for the topic"),
    Rule("msgpack", "A message", "one msgpack map of text keys, each once, without extension types"),
    Rule("required keys", "A message", "every key that the schema requires is there"),
    Rule("further keys", "A message", "no key is there that the schema does not know"),
    Rule("types", "A message", "each value has its type; text is text, bytes are bin"),
    Rule("words", "A message", "a text is one of the words of its schema, or has its pattern"),
    Rule("ranges", "Ranges", "each quantity is finite, in SI units, and within its range"),
    Rule("version", "Rules of change", "v is x-version of the schema of its topic"),
    Rule("sequence", "Sequence", "seq goes up by 1 from 0, for each topic and source by itself"),
    Rule("order of time", "A message", "t_ns never goes back"),
    Rule("clock", "A message", "t_ns is in ns since 1970, and at most 1 s from this machine's clock"),
    Rule("rate", "Topics", "no pause is longer than the topic's `stale after`"),
    Rule("health", "Topics", "a node sends node/health twice a second"),
    Rule("last message", "Sequence", "the last of all is a session/event of kind node, state ended, with sent.TOPIC"),
    Rule("identifiers", "Commands", "each command has an id of its own, and a repetition is the same command"),
    Rule("repetition", "Commands", "without an answer it comes again each 100 ms: same id, next seq, t_ns of now"),
    Rule("unknown keys", "Rules of change", "a key that is not known is ignored, and the message with it is taken"),
    Rule("end of repetition", "Commands", "a command that was answered by ack is not sent again"),
    Rule("quoted clock", "Commands", "after a refusal with expired it comes again, same id, with node_t_ns"),
    Rule("quoted stop", "Commands", "after a refusal with latch it comes again, same id, with that node_latch"),
    Rule("armed hand", "Commands", "a hand is armed by an arm that it acknowledged, until an estop; all else is not"),
    Rule("answer", "Commands", "a command to a node by its name is answered by ack or refused, with its id"),
    Rule("same answer", "Commands", "the same id is answered again with the same words"),
    Rule("expired command", "Commands", "a command that is too old is refused, with expired true in data"),
    Rule("unknown command key", "Rules of change", "a command with a key that is not known is never acknowledged"),
    Rule("others' commands", "Commands", "a command to another node is not answered"),
    Rule("robustness", "A message", "what breaks the rules, or is of a later version, does not stop a client"),
)  # fmt: skip
_BY_NAME = {rule.name: rule for rule in RULES}


class Finding(NamedTuple):
    """The finding on a rule: its outcome, and for a failed one the observed faults."""

    rule: str
    outcome: Outcome
    section: str
    right: str
    seen: str = ""

    def line(self) -> str:
        """Return the finding as a line of text."""
        text = f"{self.outcome:8}  {self.rule}"
        if self.outcome != "failed":
            return text
        return f"{text}: {self.seen}. Right: {self.right} (SPEC.md, {self.section})"


@dataclass
class Account:
    """The rules that were kept at least once, and those that were broken, with the observed faults."""

    held: set[str] = field(default_factory=set)
    broken: dict[str, dict[str, str]] = field(default_factory=dict)

    def hold(self, *names: str) -> None:
        """Record that these rules were kept."""
        self.held.update(names)

    def fail(self, name: str, seen: str, about: str = "") -> None:
        """Record a fault of a rule, once for each subject `about`; raise KeyError for an unknown rule."""
        kept = self.broken.setdefault(_BY_NAME[name].name, {})
        if len(kept) < _MOST_KEPT:
            kept.setdefault(about or seen, seen)

    def findings(self) -> list[Finding]:
        """Return the finding on each rule."""
        rows = []
        for rule in RULES:
            texts = list(self.broken.get(rule.name, {}).values())
            outcome: Outcome = "failed" if texts else "passed" if rule.name in self.held else "not seen"
            least = "at least " * (len(texts) == _MOST_KEPT)
            more = f" (and {least}{len(texts) - _MOST_LISTED} more)" if len(texts) > _MOST_LISTED else ""
            rows.append(Finding(rule.name, outcome, rule.section, rule.right, "; ".join(texts[:_MOST_LISTED]) + more))
        return rows

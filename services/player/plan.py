"""Selection of the nodes and channels of a recording to play."""

from telenano.recording.channel_filter import Selection
from telenano.recording.messages import RecordedChannel
from telenano.recording.multi_file import RecordingSource
from telenano.runtime.bus.address_book import AddressBook
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import LAUNCHER, LINK, is_console, name_of

# Never played: recorder, player, the observer `telenano record` and the page are not part of the rig, and an emergency
# stop has no endpoint to bind.
_EXCLUDED_NODES = ("recorder", "player", "record", "estop", "viz_node")
_EXCLUDED_TOPICS = ("node/health", "node/journal")


def node_of(channel: RecordedChannel) -> str:
    """Return the node at whose endpoint a channel was received; empty in a recording of another program."""
    return f"{LINK}@{channel.site}" if channel.via == "link" else channel.src


class ReplayPlan:
    """Nodes of the address book to play, and channels to publish."""

    def __init__(
        self,
        recording: RecordingSource,
        book: AddressBook,
        selection: Selection,
    ) -> None:
        """Select channels and nodes; raise ConfigError if a node is not in the address book."""
        self._selection = selection
        # A rig on one machine has no endpoint for the launcher of the slave's site, which only reports on processes.
        launchers = {channel.src for channel in recording.channels if name_of(channel.src) == name_of(LAUNCHER)}
        self.without_place = sorted(node for node in launchers if not selection.nodes and node not in book.nodes)
        self.channels = [channel for channel in recording.channels if self.plays(channel)]
        # Consoles that are not played, so that a live console can use their endpoint.
        commanded = {channel.src for channel in recording.channels if channel.topic == "session/control"}
        self.left_out = sorted(node for node in commanded if is_console(node) and not self._plays_node(node))
        self.nodes = sorted({node_of(channel) for channel in self.channels})
        absent = [node for node in self.nodes if node not in book.nodes]
        if absent:
            names = ", ".join(sorted(book.nodes))
            others = " ".join(f"--nodes {node}" for node in self.nodes if node in book.nodes)
            others = f", or play the others alone: `{others}`" if others else ""
            raise ConfigError(
                f"{recording.path}: {', '.join(absent)} is not in the site file, which has {names}; name one that has "
                f"it with --site-file{others}"
            )

    def plays(self, channel: RecordedChannel) -> bool:
        """Return whether a channel is played.

        Health is excluded because the player publishes its own, and journals because no node takes these turns now.
        """
        node = node_of(channel)
        if (
            not node
            or node in self.without_place
            or name_of(node) in _EXCLUDED_NODES
            or channel.topic in _EXCLUDED_TOPICS
        ):
            return False
        return self._plays_node(node) and self.chooses(channel.channel_topic)

    def chooses(self, channel_topic: str) -> bool:
        """Return whether a channel of this name is selected."""
        return self._selection.names(channel_topic)

    def _plays_node(self, node: str) -> bool:
        """Return whether a node is selected; a console only by name, because it is needed to command the replay."""
        if not self._selection.nodes:
            return not is_console(node)
        return any(test(node) for test in self._selection.nodes)

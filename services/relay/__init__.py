"""The relay process of a site: connects to the relay, and carries the messages between the sites."""

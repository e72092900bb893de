"""What serves a page: address, access, connections, certificates."""

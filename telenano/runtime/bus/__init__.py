"""Messages between processes: sockets, endpoints, publishers, and subscribers."""

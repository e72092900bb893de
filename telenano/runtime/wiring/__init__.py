"""Assembly of a process: its sockets and keys, its part in the bus, and its start from a command line."""

"""How a process is put together: its sockets and keys, its part in the bus, and its way from a command line."""

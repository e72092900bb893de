"""How SIGINT and SIGTERM reach a process that computes, and how every other process is started."""

"""How SIGINT and SIGTERM reach a process that computes."""

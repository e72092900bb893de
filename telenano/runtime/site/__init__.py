"""The nodes of a site in one process and one thread, each with its own endpoint (`realtime.processes: site`)."""

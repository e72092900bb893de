"""The nodes of a site in one process, where a scenario gives `realtime.processes: site`."""

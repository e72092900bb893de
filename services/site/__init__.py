"""The service that runs the nodes of a site in one process, for scenarios with `realtime.processes: site`."""

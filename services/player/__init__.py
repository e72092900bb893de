"""The process that stands in for nodes: it plays a recording on the bus."""

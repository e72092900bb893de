"""The node of the link between the sites, with its impairments."""

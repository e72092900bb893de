"""The link between the sites and its impairments."""

"""The end of a relay at a site: it dials, and carries what crosses between the sites."""

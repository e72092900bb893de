"""The impairment models of the link, one for each effect on a message."""

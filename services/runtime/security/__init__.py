"""Who may connect: keys, the list of those that are let in, and what became of every connection."""

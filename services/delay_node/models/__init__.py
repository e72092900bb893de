"""What the link may do to a message: one model each."""

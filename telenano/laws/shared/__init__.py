"""What several laws have in common; no law of its own."""

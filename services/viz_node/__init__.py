"""The process that serves the operator's page."""

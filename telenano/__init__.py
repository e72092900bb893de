"""The `telenano` command."""

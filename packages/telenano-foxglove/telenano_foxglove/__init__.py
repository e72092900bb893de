"""The bridge of telenano to Foxglove and Lichtblick."""

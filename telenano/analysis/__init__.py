"""What a recording shows: series, report, verdict of stability, and the re-run of a process."""

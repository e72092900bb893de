"""What a recording shows: series, report, verdict of stability, figures."""

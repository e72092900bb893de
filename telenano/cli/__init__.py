"""The command line: parsing, printing, completion, exit codes."""

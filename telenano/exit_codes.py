"""The exit codes of commands that failed; docs/cli.md has their meaning."""

EXIT_FAILED = 1
EXIT_BAD_CONFIGURATION = 2
# done, but the recording lacks something
EXIT_INCOMPLETE = 3

"""The exit codes of commands that failed; docs/cli.md has their meaning."""

EXIT_FAILED = 1
EXIT_BAD_CONFIGURATION = 2
# The command is done, but the recording lacks something, or a measurement does not tell what was asked.
EXIT_INCOMPLETE = 3
# A signal ended the command: SIGINT (Ctrl-C) or SIGTERM, numbered as in shells; `telenano.signals.interrupts.exit_code`
# returns which.
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

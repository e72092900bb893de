"""Run the `telenano` command without its script."""

from telenano.cli.app import main

if __name__ == "__main__":
    main()

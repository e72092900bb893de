"""`python -m telenano.testing.conformance --client ADDRESS`: the same as `telenano conformance`."""

import typer

from telenano.testing.conformance.conformance_command import conformance

if __name__ == "__main__":
    typer.run(conformance)

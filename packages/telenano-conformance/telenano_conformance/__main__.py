"""`python -m telenano_conformance --client ADDRESS`: the same as `telenano conformance`."""

import typer

from telenano_conformance.command import conformance

if __name__ == "__main__":
    typer.run(conformance)

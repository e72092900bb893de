"""`telenano bridge`: a running rig for the viewers of others. Each bridge is a package."""

from telenano.cli.options import command_group

app = command_group()


@app.callback()
def bridge() -> None:
    """Publish the messages of a running rig to other programs."""

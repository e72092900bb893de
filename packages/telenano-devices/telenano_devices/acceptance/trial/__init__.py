"""The trial of a device by its owner: questions, the motion of its acceptance, one file, one page."""

"""The trial of a device by somebody who has one: questions, the motion of its acceptance, one file, one page."""

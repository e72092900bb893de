"""What trials run on: a rig of processes that stays up, or simulated time."""

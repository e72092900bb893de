"""What the drivers, guards and emulations of AFM controllers have in common."""

"""The common parts of the drivers, guards and emulators of AFM controllers."""

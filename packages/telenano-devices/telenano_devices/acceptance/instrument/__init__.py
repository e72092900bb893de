"""The acceptance of an instrument: one motion of the base behind the guard, and the checks of its recording."""

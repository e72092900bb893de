"""What every process shares: bus, clock, loop, health, configuration."""

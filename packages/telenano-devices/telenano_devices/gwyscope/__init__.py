"""The Gwyscope as an instrument of telenano: driver, guard and emulator."""

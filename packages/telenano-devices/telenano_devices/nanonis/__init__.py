"""The Nanonis controller as an instrument of telenano: driver, guard, client and emulator."""

"""A Gwyscope as an instrument of telenano: driver, guard and emulation."""

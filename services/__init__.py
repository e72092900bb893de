"""The processes that put the library on the bus, one package each."""

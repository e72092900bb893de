"""AFM controllers as instruments of telenano: Gwyscope and Nanonis, with guards and emulators."""

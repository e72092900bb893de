"""An emulated handle and an emulated LabJack T7, to try telenano without hardware."""

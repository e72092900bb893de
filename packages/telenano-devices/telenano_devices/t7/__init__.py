"""A LabJack T7 with a stage and a deflection: a model of it as a Modbus server, and the calibration of the stage."""

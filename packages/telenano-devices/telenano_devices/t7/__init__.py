"""The LabJack T7 with a stage and a deflection: a model as a Modbus server, and the calibration of the stage."""

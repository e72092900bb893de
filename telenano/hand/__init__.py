"""The hand and its haptic device as steps without a clock: motor, operator, coupling, guard and their settings."""

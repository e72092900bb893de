"""The operator's haptic device."""

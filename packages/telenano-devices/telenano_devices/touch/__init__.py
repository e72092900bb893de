"""Driver of 3D Systems' Touch, by OpenHaptics."""

"""3D Systems' Touch, by OpenHaptics."""

"""Haptic devices for telenano: Haply's Inverse3, those of Force Dimension, and 3D Systems' Touch."""

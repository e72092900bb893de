"""Bridges of telenano to other programs: live data to Foxglove, LSL and ROS 2, and recordings in their file formats."""

"""Bridges of telenano to other programs: live to Foxglove, LSL and ROS 2, and recordings as files of theirs."""

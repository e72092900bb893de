"""The bridge of telenano to ROS 2, and its recordings as bags of ROS 2."""

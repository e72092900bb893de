"""The benchmark of teleoperation laws: fixed tasks, networks and hands, with the same results to the bit everywhere."""

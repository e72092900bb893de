"""The benchmark of teleoperation laws: fixed tasks, networks and hands, whose result has the same bits everywhere."""

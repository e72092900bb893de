"""Images and force curves: of the simulated instrument in simulated time, and of the instrument of a running rig."""

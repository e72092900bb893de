"""Images and force curves, from the simulated instrument in simulated time or from the instrument of a running rig."""

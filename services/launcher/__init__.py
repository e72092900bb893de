"""The telenano command and the supervisor of a local rig."""

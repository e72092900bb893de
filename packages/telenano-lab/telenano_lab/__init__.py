"""A laboratory around telenano: studies, networks, experiments, images, particles, calibration, and files of AFMs."""

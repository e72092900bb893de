"""Images, force curves and force maps of AFMs of other makers, for telenano."""

"""The commands of `telenano`, one file each."""

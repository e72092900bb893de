"""Recordings as tables: Parquet, CSV and HDF5, in bounded memory."""

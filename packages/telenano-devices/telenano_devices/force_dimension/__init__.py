"""Driver of Force Dimension's and Novint's devices, by the vendor's library."""

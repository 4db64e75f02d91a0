"""Groups of furniture, one module for each kind: what stands together and where."""

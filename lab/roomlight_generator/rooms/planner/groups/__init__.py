"""Groups of furniture that are placed together, one module for each kind of group."""

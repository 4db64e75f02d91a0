"""One module for each command `roomlight eval...`."""

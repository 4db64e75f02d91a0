"""One module per command of `roomlight`."""

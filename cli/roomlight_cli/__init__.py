"""The `roomlight` command."""
